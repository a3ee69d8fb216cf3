from dataclasses import dataclass
from typing import Literal

from rf_exp.statements.language.base import MultiAgentStatement, Statement, Words, agent_list
from rf_exp.statements.language.notation import number

_PARTS = r"(?P<part>grippers|hands|arms)"


@dataclass(frozen=True)
class KeepApart(MultiAgentStatement):
    """The grippers or the arms of two agents keep a minimum distance."""

    kind = "spatial"
    patterns = (
        rf"(?:{{agents}} (?:{{must}} )?(?:keeps?|holds?|have|has) (?:their |the ){_PARTS}|"
        rf"the {_PARTS} of {{agents}} (?:{{must}} )?(?:keep|stay|remain|be|are)) at least {{m}} apart",
        r"{agent} (?:{must} )?(?:keeps?|stays?|remains?) (?:a distance of )?at least {m} "
        r"(?:away )?from {agent other}",
    )

    who: tuple[int, int]
    at_least_m: float
    parts: Literal["grippers", "arms"] = "grippers"

    @property
    def sentence(self) -> str:
        return (
            f"{agent_list(self.who)} must keep their {self.parts} at least {number(self.at_least_m)} m apart."
        )

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agents = words.agents() if "part" in words else words.pair()
        if len(agents) != 2:
            raise words.error(f"is about two agents; it names {agent_list(agents)}")
        parts = "arms" if "part" not in words or words["part"] == "arms" else "grippers"
        return cls((min(agents), max(agents)), words.quantity("m", 2.0), parts)


KeepApart.samples = (KeepApart((1, 2), 0.1), KeepApart((1, 2), 0.05, "arms"))
