"""RoboBrain's answers in an episode, as values: the outcome of each, its stated and missing constraints.

A round ends once a plan has been carried out; the next one starts from the new scene. Further answers within
a round are repairs: they follow one that was refused, or stopped during execution.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby


class Ruling(StrEnum):
    """Outcome of an answer."""

    REFUSED = "refused"  # nothing moved
    STOPPED = "stopped"  # its plan passed the checks, and a measured violation ended its execution
    CARRIED_OUT = "carried out"
    NOTHING_LEFT = "nothing left"  # it has no subgoals: the task is done


@dataclass(frozen=True)
class Answer:
    """One answer."""

    round: int  # from 1
    ruling: Ruling
    code: str = ""  # `Violation.code` of what was wrong
    stated: int = 0  # constraints; 0 also where the answer could not be read
    understood: int = 0  # of them
    asked: int = 0  # constraints of the scripted plan for the same scene
    missing: int = 0  # of those: no constraint in the answer demands it of the same agents and objects
    makespan_s: float = 0.0  # of its plan, where it passed the checks
    bound_s: float = 0.0  # proven lower bound on the makespan of the same motions

    @property
    def passed(self) -> bool:
        """Whether its plan passed all checks."""
        return self.ruling in (Ruling.CARRIED_OUT, Ruling.STOPPED)


@dataclass(frozen=True)
class Dialogue:
    """All answers of an episode in order, with their cost and the work of each arm."""

    answers: tuple[Answer, ...] = ()
    calls: int = 0  # of a model, including those that restate constraints
    prompt_tokens: int = 0  # of all calls, as the server counts them
    completion_tokens: int = 0
    busy: tuple[int, ...] = ()  # control steps in which each arm was commanded to move

    @property
    def rounds(self) -> list[list[Answer]]:
        """The answers of each round."""
        return [list(answers) for _, answers in groupby(self.answers, key=lambda answer: answer.round)]

    @property
    def repairs(self) -> int:
        """Answers beyond the first of each round."""
        return len(self.answers) - len(self.rounds)

    @property
    def valid_after(self) -> int | None:
        """Repairs in the first round until a plan passed all checks; None: none did."""
        return next(
            (repairs for repairs, answer in enumerate(next(iter(self.rounds), [])) if answer.passed), None
        )

    @property
    def codes(self) -> Counter[str]:
        """Codes of what was wrong with answers, with their counts."""
        return Counter(answer.code for answer in self.answers if answer.code)

    @property
    def first_answers(self) -> Iterator[Answer]:
        """The first answer of each round, given without feedback; none where nothing was left to do."""
        return (answers[0] for answers in self.rounds if answers[0].ruling is not Ruling.NOTHING_LEFT)
