from dataclasses import dataclass

from rf_exp.statements.language.base import OneAgentStatement, Statement, Words, agent_name
from rf_exp.statements.language.notation import number

SLOWEST_M_S = 0.01  # a slower plan would take too long


@dataclass(frozen=True)
class SpeedLimit(OneAgentStatement):
    """The gripper of an agent keeps a speed limit. Its motion is planned accordingly."""

    kind = "temporal"
    patterns = (
        r"(?:{agent} (?:{not} moves?(?: its (?:gripper|hand))? faster than|"
        r"{must} move(?: its (?:gripper|hand))? (?:at most (?:at|with)|slower than|no faster than"
        r"|at no more than))"
        r"|the (?:gripper|hand) of {agent} {not} (?:be|move) faster than) {speed}",
    )

    at_most_m_s: float

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must move at most at {number(self.at_most_m_s)} m/s."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        return cls(words.agent(), words.quantity("speed", 10.0, smallest=SLOWEST_M_S))


SpeedLimit.samples = (SpeedLimit(1, 0.25),)
