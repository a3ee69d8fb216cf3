"""Notes about an episode, taken while it is made: rounds, their phases, and results of checks."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import CheckCode, CheckedPlan, compile_constraints
from rf_exp.datagen import Observer, Planned
from rf_exp.datagen.brain import BadAnswer, Brain, Question, from_json
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.recording import check_result, check_results, order_masks
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, Subgoal, spans
from rf_exp.viz.figures import coordination, timeline
from rf_exp.viz.text import CheckResult

SAME_PHASE_STEPS = 10  # subgoals that begin within half a second form one phase

Picture = NDArray[np.uint8]  # (H, W, 3) sRGB


@dataclass
class Phase:
    """The time from the beginning of some subgoals to that of the next ones."""

    begins_s: float  # since the start of the episode
    goals: tuple[Subgoal, ...]
    reached: bool = False
    picture: Picture | None = None  # at its beginning


@dataclass
class Round:
    """One proposal and its outcome."""

    begins_s: float  # since the start of the episode
    answer: str = ""  # RoboBrain's, verbatim
    proposal: Proposal | None = None
    code: CheckCode | None = None  # None: not understood
    results: tuple[CheckResult, ...] = ()  # of the checks on the plan, before any motion
    measured: dict[str, CheckResult] = field(default_factory=dict)  # check code -> result on the real state
    phases: tuple[Phase, ...] = ()
    figures: dict[str, Picture] = field(default_factory=dict)
    violation: Violation | None = None


class EpisodeLog:
    """Observer of the generation loop, and wrapper of its brain that notes the answers."""

    def __init__(self, task: Task, brain: Brain) -> None:
        self._task, self._brain = task, brain
        self._checked: CheckedPlan | None = None
        self.name = brain.name
        self.rounds: list[Round] = []

    def answer(self, question: Question) -> str:
        if self._checked is not None:  # the scene after the last step of its plan
            self._measure(self._checked, question.scene, self.rounds[-1])
        self._checked = None
        current = Round(question.scene.step * CONTROL_DT_S)
        self.rounds.append(current)
        current.answer = answer = self._brain.answer(question)
        try:
            proposal = from_json(answer, self._task)
        except BadAnswer:  # the loop reports it as a violation
            return answer
        if not proposal.subgoals:
            self.rounds.pop()  # there is nothing left to do
            return answer
        current.proposal = proposal
        with suppress(ArgumentError):  # not understood, which the loop reports too
            current.code = compile_constraints(proposal.constraints, self._task, proposal)
        return answer

    def planned(self, plan: Planned) -> None:
        current, self._checked = self.rounds[-1], plan.checked
        current.results = check_results(plan.checked)
        current.phases = phases(plan, current.begins_s)
        current.figures["lanes"] = timeline(plan.trajectories, plan.schedule)
        if pair_diagrams := plan.checked.plan.paths.diagrams:
            diagrams = coordination(
                plan.trajectories,
                plan.schedule,
                pair_diagrams,
                order_masks(plan.checker, plan.checked.plan.paths),
            )
            current.figures["diagrams"] = diagrams.picture

    def rejected(self, violation: Violation) -> None:
        self.rounds[-1].violation = violation
        self._checked = None

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, Picture]) -> None:
        if self._checked is None:
            return
        current = self.rounds[-1]
        now_s = scene.step * CONTROL_DT_S
        for phase in current.phases:
            if not phase.reached and now_s >= phase.begins_s - 1e-9:
                phase.reached, phase.picture = True, pictures.get("global")
        self._measure(self._checked, scene, current)

    def _measure(self, checked: CheckedPlan, scene: Scene, current: Round) -> None:
        """Runs the logical checks on the real state; keeps of each the worst result, or the first failure."""
        for check in checked.checks:
            evidence = check.measured(scene, checked.plan) if check.kind == "logical" else None
            if evidence is None:
                continue
            kept = current.measured.get(repr(check))
            if kept is None or (kept.ok and evidence.value > kept.value):
                current.measured[repr(check)] = check_result(check, evidence)


class ObserverGroup:
    """Observer that forwards to several observers."""

    def __init__(self, *observers: Observer) -> None:
        self._observers = observers

    def planned(self, plan: Planned) -> None:
        for observer in self._observers:
            observer.planned(plan)

    def rejected(self, violation: Violation) -> None:
        for observer in self._observers:
            observer.rejected(violation)

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, Picture]) -> None:
        for observer in self._observers:
            observer.stepped(scene, action, pictures)


def phases(plan: Planned, begins_s: float) -> tuple[Phase, ...]:
    """The phases of a plan: its subgoals in groups that begin together, in the order of their beginning.

    `begins_s` is the beginning of the plan since the start of the episode.
    """
    starts: list[tuple[int, Subgoal]] = []
    for trajectory in plan.trajectories:
        for goal, executed in groupby(
            spans(trajectory, plan.schedule), key=lambda span: span.segment.subgoal
        ):
            starts.append((next(executed).begins, goal))
    groups: list[tuple[int, list[Subgoal]]] = []
    for step, goal in sorted(starts, key=lambda each: (each[0], each[1].agent)):
        if groups and step - groups[-1][0] <= SAME_PHASE_STEPS:
            groups[-1][1].append(goal)
        else:
            groups.append((step, [goal]))
    return tuple(Phase(begins_s + step * CONTROL_DT_S, tuple(goals)) for step, goals in groups)
