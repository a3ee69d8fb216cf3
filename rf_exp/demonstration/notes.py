"""Notes about an episode, taken while it is made: rounds, their phases, and results of checks."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import CheckCode, CheckedPlan, compile
from rf_exp.datagen import Observer, Planned
from rf_exp.datagen.brain import BadAnswer, Brain, Question, from_json
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.recording import check_result, check_results, orders
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, Subgoal, spans
from rf_exp.viz.figures import coordination, lanes
from rf_exp.viz.text import CheckResult

TOGETHER_STEPS = 10  # subgoals that begin within half a second form one phase

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


class Notes:
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
        now = Round(question.scene.step * CONTROL_DT_S)
        self.rounds.append(now)
        now.answer = answer = self._brain.answer(question)
        try:
            proposal = from_json(answer, self._task)
        except BadAnswer:  # the loop reports it as a violation
            return answer
        if not proposal.subgoals:
            self.rounds.pop()  # there is nothing left to do
            return answer
        now.proposal = proposal
        with suppress(ArgumentError):  # not understood, which the loop reports too
            now.code = compile(proposal.constraints, self._task, proposal)
        return answer

    def planned(self, plan: Planned) -> None:
        now, self._checked = self.rounds[-1], plan.checked
        now.results = check_results(plan.checked)
        now.phases = phases(plan, now.begins_s)
        now.figures["lanes"] = lanes(plan.trajectories, plan.schedule)
        if found := plan.checked.plan.paths.diagrams:
            diagrams = coordination(
                plan.trajectories, plan.schedule, found, orders(plan.checker, plan.checked.plan.paths)
            )
            now.figures["diagrams"] = diagrams.picture

    def rejected(self, violation: Violation) -> None:
        self.rounds[-1].violation = violation
        self._checked = None

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, Picture]) -> None:
        if self._checked is None:
            return
        now = self.rounds[-1]
        now_s = scene.step * CONTROL_DT_S
        for phase in now.phases:
            if not phase.reached and now_s >= phase.begins_s - 1e-9:
                phase.reached, phase.picture = True, pictures.get("global")
        self._measure(self._checked, scene, now)

    def _measure(self, checked: CheckedPlan, scene: Scene, now: Round) -> None:
        """Runs the logical checks on the real state; keeps of each the worst result, or the first failure."""
        for check in checked.checks:
            evidence = check.measured(scene, checked.plan) if check.kind == "logical" else None
            if evidence is None:
                continue
            known = now.measured.get(repr(check))
            if known is None or (known.ok and evidence.value > known.value):
                now.measured[repr(check)] = check_result(check, evidence)


class Together:
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
    begins: list[tuple[int, Subgoal]] = []
    for trajectory in plan.trajectories:
        for goal, run in groupby(spans(trajectory, plan.schedule), key=lambda span: span.segment.subgoal):
            begins.append((next(run).begins, goal))
    groups: list[tuple[int, list[Subgoal]]] = []
    for step, goal in sorted(begins, key=lambda each: (each[0], each[1].agent)):
        if groups and step - groups[-1][0] <= TOGETHER_STEPS:
            groups[-1][1].append(goal)
        else:
            groups.append((step, [goal]))
    return tuple(Phase(begins_s + step * CONTROL_DT_S, tuple(goals)) for step, goals in groups)
