"""RoboBrain and RoboChecker during rollouts: which subgoal each agent is at, and whether it has to wait.

The paper's division of labour, applied to policies: subgoals and their order come from a checked plan,
motion from the learned policy. Plans are made from the true scene, at the start and whenever one is
completed, so an architecture that receives them (`separate_coordinated`) knows more than its cameras show.

Each arm is tracked along its planned path: its position is where the path comes closest to its gripper,
whatever the other joints do. The position never decreases, and the path's gripper command there equals the
arm's own. An arm that the plan lets wait may go on once the others are where the plan has them by then.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain import Question
from rf_exp.datagen.motion.state import Floats
from rf_exp.datagen.planning import Planned, Planner, Settings
from rf_exp.datagen.subgoals import Subgoals
from rf_exp.robots import Arm
from rf_exp.transforms import transform_by_poses
from rf_exp.types import PLANNING, Scene, Subgoal, gripper_of, without_height

COORDINATOR_VERSION = 7  # raise it whenever its decisions change
MAX_ADVANCE_STEPS = 30  # largest advance on a path at once: policies cut corners
REACHED_STEPS, REACHED_M = 3, 0.005  # an arm this near to the end of a segment has reached it
STANDSTILL_STEPS, STANDSTILL_M = 10, 0.02  # likewise where it has to wait, after standing still for so long
STILL_M = 5e-4  # a gripper that moves less in a control step stands still
SLACK_STEPS = 5  # by which other arms may be behind the plan
RETRY_STEPS = 20  # until RoboBrain is asked again when it had no plan
NEAREST_TOLERANCE_M = 5e-4  # path positions this much farther than the nearest one count as equally near
GRIPPER_POINTS_M = 0.1 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # in the TCP frame


class Coordinator:
    """Coordinator of one episode, from its first scene on. Plans anew once all agents reach the end."""

    def __init__(
        self, settings: Settings, seed: int, scene: Scene, names: Sequence[Sequence[str]] = ()
    ) -> None:
        """`names`: subgoals of each agent in the order of their numbers, where policies have learned some."""
        self._task, self._planner = settings.task, Planner(settings, settings.make_brain(seed))
        self._arms = tuple(settings.task.arms.values())
        self._rng = np.random.default_rng([seed, PLANNING])  # as data generation does
        self._subgoals, self._names = Subgoals(len(settings.task.agents)), names
        self._completed: tuple[Subgoal, ...] = ()
        self._plan: Planned | None = None  # the present one, if any
        self._positions = np.zeros((1, len(settings.task.agents)), np.int64)  # (T + 1, N), its schedule
        # Per agent: path (P, dof + 1), points of the gripper along it (P, 4, 3), knots.
        self._paths: list[Floats] = []
        self._gripper_paths_m: list[Floats] = []
        self._knots: list[NDArray[np.int64]] = []
        self._subgoal_numbers = [np.zeros(1, np.int64) for _ in settings.task.agents]
        self._planned_at, self._reached = (
            scene.step,
            np.zeros(len(settings.task.agents), int),
        )  # path positions
        grippers = zip(self._arms, scene.qpos, strict=True)
        self._last_grippers_m = [gripper_points_m(arm, qpos) for arm, qpos in grippers]
        self._still_steps = [0] * len(self._arms)  # control steps without motion
        self._plan_next(scene)

    def _plan_next(self, scene: Scene) -> None:
        """Makes the next plan, from this scene on. Without one, every agent keeps its last subgoal."""
        self._completed += () if self._plan is None else self._plan.proposal.subgoals
        result = self._planner.plan(Question(self._task, scene, {}, self._completed), scene, self._rng)
        self._planned_at, self._reached = scene.step, np.zeros_like(self._reached)
        if not isinstance(result, Planned):
            self._plan, self._subgoal_numbers = None, [each[-1:] for each in self._subgoal_numbers]
            return
        self._plan, self._positions = result, result.schedule.positions
        self._paths = [trajectory.path() for trajectory in result.trajectories]
        paths = zip(self._arms, self._paths, strict=True)
        self._gripper_paths_m = [gripper_points_m(arm, path) for arm, path in paths]
        self._knots = [np.array(trajectory.knots) for trajectory in result.trajectories]
        numbers = self._subgoals.number_steps(result.trajectories, result.schedule)
        self._subgoal_numbers = []  # per agent: the number of its next subgoal at each path position
        for k, path in enumerate(self._paths):
            steps = np.searchsorted(self._positions[:, k], range(len(path)))
            goals = [without_height(text) for text in self._subgoals.texts[k]]
            names = [*(self._names[k] if self._names else ()), *goals]  # repeated subgoals keep their number
            first = np.array([names.index(goal) for goal in goals])
            self._subgoal_numbers.append(first[numbers[np.minimum(steps + 1, len(numbers) - 1), k]])

    def __call__(
        self, scene: Scene, grippers: Mapping[int, float]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(N,) the number of each agent's subgoal and (N,) whether it may go on, in the present scene.

        `grippers` are the last commands by agent, open before the first.
        """
        if self._plan is None:
            replan = scene.step - self._planned_at >= RETRY_STEPS
        else:
            for k in range(len(self._reached)):
                self._reached[k] = self._update_position(k, scene.qpos[k], grippers[k + 1])
            replan = all(at == knots[-1] for at, knots in zip(self._reached, self._knots, strict=True))
        if replan:
            self._plan_next(scene)
        present = zip(self._subgoal_numbers, self._reached, strict=True)
        numbers = np.array([by_position[at] for by_position, at in present])
        may_proceed = [self._plan is None or self._may_proceed(k) for k in range(len(self._reached))]
        return numbers, np.array(may_proceed)

    def _update_position(self, k: int, qpos: Floats, gripper: float) -> int:
        """The present path position of an agent."""
        at, path, knots = int(self._reached[k]), self._paths[k], self._knots[k]
        gripper_m = gripper_points_m(self._arms[k], qpos)
        moved_m = np.linalg.norm(gripper_m - self._last_grippers_m[k], axis=-1).mean()
        self._last_grippers_m[k] = gripper_m
        self._still_steps[k] = self._still_steps[k] + 1 if moved_m < STILL_M else 0
        ahead = path[at : at + MAX_ADVANCE_STEPS + 1]
        matches = (gripper_of(ahead) > 0) == (gripper > 0)
        if not matches[0]:  # commanded earlier or later than planned
            return at + int(np.argmax(matches))
        if not matches.all():  # no progress beyond a gripper change before the change
            ahead = ahead[: int(np.argmin(matches))]
        offsets_m = self._gripper_paths_m[k][at : at + len(ahead)] - gripper_m
        distances_m = np.linalg.norm(offsets_m, axis=-1).mean(axis=-1)
        nearest = at + int(np.flatnonzero(distances_m <= distances_m.min() + NEAREST_TOLERANCE_M)[-1])
        end = int(knots[np.searchsorted(knots, nearest)])
        if end >= at + len(ahead):
            return nearest
        # A motion ends slowly: an arm that lags by millimetres under a load is more than a few steps behind.
        if end - nearest <= REACHED_STEPS or distances_m[end - at] <= REACHED_M:
            return end
        # A disturbed arm waits slightly off the planned pose.
        is_waiting = (
            np.count_nonzero(self._positions[:, k] == end) > 1 and self._still_steps[k] >= STANDSTILL_STEPS
        )
        return end if is_waiting and distances_m[end - at] <= STANDSTILL_M else nearest

    def _may_proceed(self, k: int) -> bool:
        """Whether an agent between two segments may begin the next one."""
        knots = self._knots[k]
        at = knots[np.searchsorted(knots, self._reached[k], side="right") - 1]
        if at == knots[-1]:  # until all agents reach the end of the plan
            return False
        if self._reached[k] - at > REACHED_STEPS:  # it has already begun
            return True
        # Also where the plan has no wait: the others may be later than planned.
        departs = int(np.searchsorted(self._positions[:, k], at, side="right"))  # first step beyond the knot
        needed_positions = self._positions[departs - 1] - SLACK_STEPS
        others = np.arange(len(needed_positions)) != k
        return bool((self._reached >= needed_positions)[others].all())


def gripper_points_m(arm: Arm, qpos: Floats) -> Floats:
    """(..., 4, 3) m, in the world: points of an arm's gripper that determine its pose."""
    return transform_by_poses(arm.tcp(qpos), GRIPPER_POINTS_M)
