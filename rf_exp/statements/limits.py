"""Limits that people ask for first: distance, tilt, height, speed."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from rf_exp.statements.base import Form, OfAgent, OfAgents, Statement
from rf_exp.statements.notation import Words, number
from rf_exp.statements.vocabulary import agent_name, listed
from rf_exp.types import Kind

SLOWEST_M_S = 0.01  # a slower plan would take for ever
LEVEL_DEG = 10.0  # what level means when no angle is given


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


@dataclass(frozen=True)
class KeepLevel(Statement):
    """What an agent carries, or all who carry it, is tilted by no more than so much, against how it stood."""

    kind: ClassVar[Kind] = "logical"

    object: str
    within_deg: float = LEVEL_DEG
    agent: int | None = None

    @property
    def agents(self) -> tuple[int, ...]:
        return () if self.agent is None else (self.agent,)

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return ((self.object, None),)

    @property
    def sentence(self) -> str:
        within = f"level within {number(self.within_deg)} deg."
        if self.agent is None:
            return f"{self.object} must stay {within}"
        return f"{agent_name(self.agent)} must keep {self.object} {within}"

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        level = r"(?:level|upright|horizontal)(?:,? (?:to )?within {deg})?"
        return (
            Form(rf"{{agent}} {{must}} (?:keep|hold|carry) {{object}} {level}", cls._read),
            Form(
                rf"(?:keep {{object}}|{{object}} {{must}} (?:stay|remain|be|be kept|be held)) {level}",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        agent = words.agent() if "agent" in words else None
        return cls(words.object(), words.quantity("deg", 90.0, LEVEL_DEG), agent)


@dataclass(frozen=True)
class KeepHeight(OfAgent):
    """The gripper of an agent stays below, or above, a height over the table."""

    kind: ClassVar[Kind] = "spatial"

    limit_m: float
    side: Literal["below", "above"] = "below"

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must keep its gripper {self.side} {number(self.limit_m)} m."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        gripper = (
            r"(?:{agent} {must} (?:keep|hold) (?:its|the) (?:gripper|hand)|the (?:gripper|hand) of {agent} "
        )
        return (
            Form(
                gripper + r"{must} (?:stay|remain|be|be kept)) (?P<side>below|under|above|over) {m}"
                r"(?: (?:above|over) the table)?",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        side = "below" if words["side"] in ("below", "under") else "above"
        return cls(words.agent(), words.quantity("m", 2.0), side)


@dataclass(frozen=True)
class SpeedLimit(OfAgent):
    """The gripper of an agent moves no faster than so much. Its motion is planned that slow."""

    kind: ClassVar[Kind] = "temporal"

    at_most_m_s: float

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must move at most at {number(self.at_most_m_s)} m/s."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"(?:{agent} (?:{not} moves?(?: its (?:gripper|hand))? faster than|"
                r"{must} move(?: its (?:gripper|hand))? (?:at most (?:at|with)|slower than|no faster than"
                r"|at no more than))"
                r"|the (?:gripper|hand) of {agent} {not} (?:be|move) faster than) {speed}",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        return cls(words.agent(), words.quantity("speed", 10.0, smallest=SLOWEST_M_S))


KeepApart.samples = (KeepApart((1, 2), 0.1), KeepApart((1, 2), 0.05, "arms"))
KeepLevel.samples = (KeepLevel("lid", 5.0, 1), KeepLevel("pot"))
KeepHeight.samples = (KeepHeight(1, 0.5), KeepHeight(1, 0.02, "above"))
SpeedLimit.samples = (SpeedLimit(1, 0.25),)
