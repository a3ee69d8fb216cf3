"""Spatial: two grippers, or two arms, keep a distance."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from rf_exp.statements.language.base import Form, OfAgents, Statement
from rf_exp.statements.language.notation import Words, number
from rf_exp.statements.language.vocabulary import listed
from rf_exp.types import Kind


@dataclass(frozen=True)
class KeepApart(OfAgents):
    """The grippers or the arms of two agents stay at least so far apart."""

    kind: ClassVar[Kind] = "spatial"

    who: tuple[int, int]
    at_least_m: float
    parts: Literal["grippers", "arms"] = "grippers"

    @property
    def sentence(self) -> str:
        return f"{listed(self.who)} must keep their {self.parts} at least {number(self.at_least_m)} m apart."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        part = r"(?P<part>grippers|hands|arms)"
        return (
            Form(
                rf"(?:{{agents}} (?:{{must}} )?(?:keeps?|holds?|have|has) (?:their |the ){part}|"
                rf"the {part} of {{agents}} (?:{{must}} )?(?:keep|stay|remain|be|are)) at least {{m}} apart",
                cls._read,
            ),
            Form(
                r"{agent} (?:{must} )?(?:keeps?|stays?|remains?) (?:a distance of )?at least {m} "
                r"(?:away )?from {agent other}",
                lambda words: cls._of(words, words.several((words.agent(), words.agent("other"))), "arms"),
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        return cls._of(words, words.agents(), "arms" if words["part"] == "arms" else "grippers")

    @classmethod
    def _of(cls, words: Words, agents: tuple[int, ...], parts: Literal["grippers", "arms"]) -> Statement:
        if len(agents) != 2:
            raise words.refused(f"is about two agents; it names {listed(agents)}")
        return cls((min(agents), max(agents)), words.quantity("m", 2.0), parts)


KeepApart.samples = (KeepApart((1, 2), 0.1), KeepApart((1, 2), 0.05, "arms"))
