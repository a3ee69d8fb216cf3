"""What is kept of RoboBrain's answers while an episode is made, beside what the scripted plan asks there."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain import Question
from rf_exp.datagen.planning import Planned
from rf_exp.findings import Answer, Dialogue, Ruling, Violation
from rf_exp.statements import Proposal, Statement, Step, Unread
from rf_exp.types import CONTROL_DT_S


class Answers:
    """Those of one episode."""

    def __init__(self) -> None:
        self._kept: list[Answer] = []
        self._round = 1

    def note(
        self,
        question: Question,
        proposal: Proposal | None,
        plan: Planned | Violation | None,
        stopped: Violation | None,
    ) -> None:
        """One more: the question, what was proposed if it could be read, what planning and execution gave."""
        wrong = plan if isinstance(plan, Violation) else stopped
        told = dict[str, float]()
        if isinstance(plan, Planned):
            ruling = Ruling.STOPPED if stopped else Ruling.CARRIED_OUT
            schedule = plan.schedule
            told["makespan_s"] = round(len(schedule) * CONTROL_DT_S, 3)
            told["bound_s"] = round(schedule.makespan_bound * CONTROL_DT_S, 3)
        else:
            ruling = Ruling.NOTHING_LEFT if plan is None else Ruling.REFUSED
        stated = proposal.constraints if proposal is not None else ()
        asked = question.task.module.plan(question.scene, question.task).constraints
        answer = Answer(
            round=self._round,
            ruling=ruling,
            code=wrong.code if wrong is not None else "",
            stated=len(stated),
            understood=sum(not isinstance(each, Unread) for each in stated),
            asked=len(asked),
            missing=len(missing(asked, stated)),
            **told,
        )
        self._kept.append(answer)
        self._round += ruling is Ruling.CARRIED_OUT

    def dialogue(self, commands: Sequence[NDArray[np.float64]]) -> Dialogue:
        """All of them, of an episode in which those commands (N, A) were given."""
        if not commands:
            return Dialogue(tuple(self._kept))
        moves = np.diff(np.stack(commands), axis=0, prepend=commands[:1]) != 0
        return Dialogue(tuple(self._kept), busy=tuple(moves.any(axis=2).sum(axis=0).tolist()))


def missing(asked: Iterable[Statement], stated: Iterable[Statement]) -> list[Statement]:
    """Those constraints that nothing stated asks of the same agents and things, whatever its numbers."""
    known = {_about(each) for each in stated}
    return [each for each in asked if _about(each) not in known]


def _about(stated: Statement) -> tuple[object, ...]:
    """What two statements have in common that differ in their numbers, or in the order of agents, alone."""
    steps: Iterator[object] = (part for part in vars(stated).values() if isinstance(part, Step))
    words = (part for part in vars(stated).values() if isinstance(part, str))
    return type(stated), frozenset(stated.agents), frozenset(stated.names), *steps, *words
