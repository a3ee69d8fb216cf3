from dataclasses import dataclass
from typing import Literal

from rf_exp.statements.language.base import OneAgentStatement, Statement, Words, agent_name
from rf_exp.statements.language.notation import number


@dataclass(frozen=True)
class KeepHeight(OneAgentStatement):
    """The gripper of an agent stays below, or above, a height over the table."""

    kind = "spatial"
    patterns = (
        r"(?:{agent} {must} (?:keep|hold) (?:its|the) (?:gripper|hand)|the (?:gripper|hand) of {agent} "
        r"{must} (?:stay|remain|be|be kept)) (?P<side>below|under|above|over) {m}"
        r"(?: (?:above|over) the table)?",
    )

    limit_m: float
    side: Literal["below", "above"] = "below"

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must keep its gripper {self.side} {number(self.limit_m)} m."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        side = "below" if words["side"] in ("below", "under") else "above"
        return cls(words.agent(), words.quantity("m", 2.0), side)


KeepHeight.samples = (KeepHeight(1, 0.5), KeepHeight(1, 0.02, "above"))
