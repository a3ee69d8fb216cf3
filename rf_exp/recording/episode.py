"""An expert episode: the bridge from checker and generation loop to `rf_exp.viz`."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Check, CheckedPlan, Evidence, Paths, RoboChecker
from rf_exp.coordination import Demands
from rf_exp.datagen import Planned
from rf_exp.findings import Violation
from rf_exp.geometry import Mask, centres_m
from rf_exp.recording.scene import SceneRecorder
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.types import Scene, activity
from rf_exp.viz.text import CheckResult

CAMERAS = "cameras"  # owner of the voxels that they see


class EpisodeRecorder(SceneRecorder):
    """Records one episode; an observer of the generation loop, a context manager."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "plan")
        self._plan: Planned | None = None
        self._since = 0  # step at which the plan began
        self._doing: dict[int, tuple[str, str]] = {}  # agent -> subgoal, primitive

    def planned(self, plan: Planned) -> None:
        """Proposal, check code, the evidence of every check, the diagrams, and what the cameras saw."""
        self._plan, self._since = plan, 0 if self._scene is None else self._scene.step + 1
        self._recorder.proposal(plan.proposal)
        self._recorder.checked(check_results(plan.checked))
        paths = plan.checked.plan.paths
        if paths.scene.seen is not None:
            self._recorder.occupancy(CAMERAS, centres_m(paths.scene.seen))
        self._recorder.coordination(
            plan.trajectories, plan.schedule, paths.diagrams, orders(plan.checker, paths)
        )

    def rejected(self, violation: Violation) -> None:
        """A violation, marked at the hands of the agents involved; it ends what was going on."""
        self._recorder.violation(violation, self._hands_m(violation.agents))
        self._plan = None
        for agent in self._task.agents:
            self._do(agent, "", "")

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        """One control step: poses, curves, pictures, occupancy, and what each agent is about."""
        self.look(scene, action, pictures)
        if self._plan is not None:
            self._follow(self._plan, scene.step - self._since + 1)

    def _follow(self, plan: Planned, step: int) -> None:
        """What each agent does in a control step of the plan, the first being 1."""
        self._recorder.positions(plan.schedule.positions[min(step, len(plan.schedule))])
        for trajectory in plan.trajectories:
            now = activity(trajectory, plan.schedule, step)
            subgoal, primitive = (
                ("", "") if now.segment is None else (now.segment.subgoal.text, now.segment.primitive)
            )
            self._do(trajectory.agent, subgoal, primitive if now.moves else "")

    def _do(self, agent: int, subgoal: str, primitive: str) -> None:
        if self._doing.get(agent, ("", "")) != (subgoal, primitive):
            self._doing[agent] = subgoal, primitive
            self._recorder.motion(agent, subgoal, primitive)


def check_results(checked: CheckedPlan) -> tuple[CheckResult, ...]:
    """The evidence of all checks on a plan, ready to be shown."""
    return tuple(map(check_result, checked.checks, checked.evidence))


def check_result(check: Check, evidence: Evidence) -> CheckResult:
    """A check with its evidence, ready to be shown."""
    return CheckResult(
        repr(check),
        check.text,
        evidence.ok,
        evidence.value,
        evidence.bound,
        check.unit,
        evidence.time_s,
        evidence.sentence,
    )


def orders(checker: RoboChecker, paths: Paths) -> Mapping[tuple[int, int], Mask]:
    """(P_i, P_j) for pairs of agents i < j: True where what a plan demands of timing forbids to be."""
    demands = Demands(paths.trajectories)
    for rule in checker.rules(paths):
        rule.demand(demands)
    return demands.cells
