"""What RoboBrain answered in an episode, as values: what became of each answer, what it says and lacks.

A round ends once a plan has been carried out; the next one goes on from the new scene. Further answers within
a round are repairs: they come after one that was refused, or stopped while it was carried out.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby


class Ruling(StrEnum):
    """What became of an answer."""

    REFUSED = "refused"  # nothing moved
    STOPPED = "stopped"  # its plan passed the checks, and was ended by what was measured on the way
    CARRIED_OUT = "carried out"
    NOTHING_LEFT = "nothing left"  # it has no subgoals: the task is done


@dataclass(frozen=True)
class Answer:
    """One answer."""

    round: int  # from 1
    ruling: Ruling
    code: str = ""  # of what was found wrong (`Violation.code`)
    stated: int = 0  # constraints; 0 also where the answer could not be read
    understood: int = 0  # of them
    asked: int = 0  # constraints of the scripted plan for the same scene
    missing: int = 0  # of those: nothing in the answer asks the same of the same agents and things
    makespan_s: float = 0.0  # of its plan, where it passed the checks
    bound_s: float = 0.0  # below which no schedule of the same motions is, proven

    @property
    def passed(self) -> bool:
        """Whether its plan passed all checks."""
        return self.ruling in (Ruling.CARRIED_OUT, Ruling.STOPPED)


@dataclass(frozen=True)
class Dialogue:
    """All of them, in their order, with what they cost and how much of the work each arm got."""

    answers: tuple[Answer, ...] = ()
    calls: int = 0  # of a model; restating constraints takes some too
    prompt_tokens: int = 0  # of all calls, as the server counts them
    completion_tokens: int = 0
    busy: tuple[int, ...] = ()  # control steps in which each arm was told to move

    @property
    def rounds(self) -> list[list[Answer]]:
        """The answers of each round."""
        return [list(some) for _, some in groupby(self.answers, key=lambda each: each.round)]

    @property
    def repairs(self) -> int:
        """Answers beyond the first of each round."""
        return len(self.answers) - len(self.rounds)

    @property
    def valid_after(self) -> int | None:
        """Repairs until a first plan passed all checks; None: none did."""
        return next((k for k, each in enumerate(next(iter(self.rounds), [])) if each.passed), None)

    @property
    def codes(self) -> Counter[str]:
        """What was found wrong with answers, and how often."""
        return Counter(each.code for each in self.answers if each.code)

    @property
    def firsts(self) -> Iterator[Answer]:
        """The first answer of each round, which no complaint has shaped; not where nothing was left to do."""
        return (some[0] for some in self.rounds if some[0].ruling is not Ruling.NOTHING_LEFT)
