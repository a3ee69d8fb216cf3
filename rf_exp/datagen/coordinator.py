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
from rf_exp.transforms import placed
from rf_exp.types import PLANNING, Scene, Subgoal, gripper_of, what_of

COORDINATOR_VERSION = 7  # raise it whenever its decisions change
AHEAD_STEPS = 30  # largest advance on a path at once: policies cut corners
REACHED_STEPS, REACHED_M = 3, 0.005  # an arm this near to the end of a segment has reached it
STOOD_STEPS, STOOD_M = 10, 0.02  # likewise where it has to wait, after standing still for so long
STILL_M = 5e-4  # a gripper that moves less in a control step stands still
SLACK_STEPS = 5  # by which other arms may be behind the plan
AGAIN_STEPS = 20  # until RoboBrain is asked again when it had no plan
NEAREST_M = 5e-4  # path positions this much farther than the nearest one count as equally near
HAND_M = 0.1 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of a gripper, in the TCP frame


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
        self._done: tuple[Subgoal, ...] = ()
        self._plan: Planned | None = None  # the present one, if any
        self._positions = np.zeros((1, len(settings.task.agents)), np.int64)  # (T + 1, N), its schedule
        # Per agent: path (P, dof + 1), points of the gripper along it (P, 4, 3), knots.
        self._paths: list[Floats] = []
        self._hands: list[Floats] = []
        self._knots: list[NDArray[np.int64]] = []
        self._numbers = [np.zeros(1, np.int64) for _ in settings.task.agents]
        self._asked_at, self._at = scene.step, np.zeros(len(settings.task.agents), int)  # path positions
        self._were = [hand(arm, qpos) for arm, qpos in zip(self._arms, scene.qpos, strict=True)]  # grippers
        self._stood = [0] * len(self._arms)  # control steps without motion
        self._next(scene)

    def _next(self, scene: Scene) -> None:
        """Makes the next plan, from this scene on. Without one, every agent keeps its last subgoal."""
        self._done += () if self._plan is None else self._plan.proposal.subgoals
        made = self._planner.plan(Question(self._task, scene, {}, self._done), scene, self._rng)
        self._asked_at, self._at = scene.step, np.zeros_like(self._at)
        if not isinstance(made, Planned):
            self._plan, self._numbers = None, [numbers[-1:] for numbers in self._numbers]
            return
        self._plan, self._positions = made, made.schedule.positions
        self._paths = [trajectory.path() for trajectory in made.trajectories]
        self._hands = [hand(arm, path) for arm, path in zip(self._arms, self._paths, strict=True)]
        self._knots = [np.array(trajectory.knots) for trajectory in made.trajectories]
        doing = self._subgoals.of_plan(made.trajectories, made.schedule)
        self._numbers = []  # per agent: the number of its next subgoal at each path position
        for k, path in enumerate(self._paths):
            steps = np.searchsorted(self._positions[:, k], range(len(path)))
            told = [what_of(text) for text in self._subgoals.texts[k]]
            names = [*(self._names[k] if self._names else ()), *told]  # repeated subgoals keep their number
            first = np.array([names.index(what) for what in told])
            self._numbers.append(first[doing[np.minimum(steps + 1, len(doing) - 1), k]])

    def __call__(
        self, scene: Scene, grippers: Mapping[int, float]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(N,) the number of each agent's subgoal and (N,) whether it may go on, in the present scene.

        `grippers` are the last commands by agent, open before the first.
        """
        if self._plan is None:
            over = scene.step - self._asked_at >= AGAIN_STEPS
        else:
            for k in range(len(self._at)):
                self._at[k] = self._followed(k, scene.qpos[k], grippers[k + 1])
            over = all(at == knots[-1] for at, knots in zip(self._at, self._knots, strict=True))
        if over:
            self._next(scene)
        numbers = np.array([of[at] for of, at in zip(self._numbers, self._at, strict=True)])
        free = [self._plan is None or self._free(k) for k in range(len(self._at))]
        return numbers, np.array(free)

    def _followed(self, k: int, qpos: Floats, gripper: float) -> int:
        """The present path position of an agent."""
        at, path, knots = int(self._at[k]), self._paths[k], self._knots[k]
        now = hand(self._arms[k], qpos)
        moved_m = np.linalg.norm(now - self._were[k], axis=-1).mean()
        self._were[k], self._stood[k] = now, self._stood[k] + 1 if moved_m < STILL_M else 0
        ahead = path[at : at + AHEAD_STEPS + 1]
        alike = (gripper_of(ahead) > 0) == (gripper > 0)
        if not alike[0]:  # commanded earlier or later than planned
            return at + int(np.argmax(alike))
        if not alike.all():  # no progress beyond a gripper change before the change
            ahead = ahead[: int(np.argmin(alike))]
        away = self._hands[k][at : at + len(ahead)] - now
        off_m = np.linalg.norm(away, axis=-1).mean(axis=-1)
        near = at + int(np.flatnonzero(off_m <= off_m.min() + NEAREST_M)[-1])
        end = int(knots[np.searchsorted(knots, near)])
        if end >= at + len(ahead):
            return near
        # A motion ends slowly: an arm that lags by millimetres under a load is more than a few steps behind.
        if end - near <= REACHED_STEPS or off_m[end - at] <= REACHED_M:
            return end
        # A disturbed arm waits slightly off the planned pose.
        waits = np.count_nonzero(self._positions[:, k] == end) > 1 and self._stood[k] >= STOOD_STEPS
        return end if waits and off_m[end - at] <= STOOD_M else near

    def _free(self, k: int) -> bool:
        """Whether an agent between two segments may begin the next one."""
        knots = self._knots[k]
        at = knots[np.searchsorted(knots, self._at[k], side="right") - 1]
        if at == knots[-1]:  # until all agents reach the end of the plan
            return False
        if self._at[k] - at > REACHED_STEPS:  # it has already begun
            return True
        # Also where the plan has no wait: the others may be later than planned.
        leaves = int(np.searchsorted(self._positions[:, k], at, side="right"))  # first step beyond the knot
        needed = self._positions[leaves - 1] - SLACK_STEPS
        others = np.arange(len(needed)) != k
        return bool((self._at >= needed)[others].all())


def hand(arm: Arm, qpos: Floats) -> Floats:
    """(..., 4, 3) m, in the world: points of an arm's gripper that determine its pose."""
    return placed(arm.tcp(qpos), HAND_M)
