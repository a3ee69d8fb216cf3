"""RoboBrain and RoboChecker while policies act: who is at which subgoal, and who waits for whom.

The paper's division of labour, carried over to policies: subgoals and their order come from a checked plan,
motion from what was learned. Plans are made from the true scene, at the start and whenever one is carried
out, so an architecture that is told of them (`separate_coordinated`) knows more than its cameras show.

Each arm is followed along its planned path: it is where the path comes closest to its hand, whatever its
other joints do, never behind where it was, and only where the path's gripper is as the arm's own was told to
be. An arm that stands where the plan lets it wait may go on once the others are where the plan has them by
then.
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

COORDINATOR_VERSION = 7  # of what it decides
AHEAD_STEPS = 30  # of its path that an arm may get on with at once: policies cut corners
REACHED_STEPS, REACHED_M = 3, 0.005  # this near to the end of a segment an arm has come to its end
STOOD_STEPS, STOOD_M = 10, 0.02  # or to one where it has to wait, once it has stood still for so long
STILL_M = 5e-4  # that the hand of an arm that stands still moves in a control step
SLACK_STEPS = 5  # that others may lack of where the plan has them
AGAIN_STEPS = 20  # until RoboBrain is asked again when it had no plan
NEAREST_M = 5e-4  # positions of a path this much farther than the nearest one are as near
HAND_M = 0.1 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of a hand, in its TCP's frame


class Coordinator:
    """Of one episode, from its first scene on. Asks for the next plan once everybody has come to the end."""

    def __init__(
        self, settings: Settings, seed: int, scene: Scene, names: Sequence[Sequence[str]] = ()
    ) -> None:
        """`names` of the subgoals of each agent, in the order of their numbers, where policies know them."""
        self._task, self._planner = settings.task, Planner(settings, settings.make_brain(seed))
        self._arms = tuple(settings.task.arms.values())
        self._rng = np.random.default_rng([seed, PLANNING])  # as generation plans
        self._subgoals, self._names = Subgoals(len(settings.task.agents)), names
        self._done: tuple[Subgoal, ...] = ()
        self._plan: Planned | None = None  # that is followed; None while there is none
        self._positions = np.zeros((1, len(settings.task.agents)), np.int64)  # (T + 1, N) of its schedule
        # Of each agent (P, dof + 1), where its hand is, and its knots.
        self._paths: list[Floats] = []
        self._hands: list[Floats] = []
        self._knots: list[NDArray[np.int64]] = []
        self._numbers = [np.zeros(1, np.int64) for _ in settings.task.agents]
        self._asked_at, self._at = scene.step, np.zeros(len(settings.task.agents), int)  # path positions
        self._were = [hand(arm, qpos) for arm, qpos in zip(self._arms, scene.qpos, strict=True)]  # the hands
        self._stood = [0] * len(self._arms)  # control steps
        self._next(scene)

    def _next(self, scene: Scene) -> None:
        """Makes the next plan, from this scene on. Without one everybody stays with what was told last."""
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
        self._numbers = []  # of each agent, by where it is on its path: what it does next
        for k, path in enumerate(self._paths):
            steps = np.searchsorted(self._positions[:, k], range(len(path)))
            told = [what_of(text) for text in self._subgoals.texts[k]]
            names = [*(self._names[k] if self._names else ()), *told]  # what is told again keeps its number
            first = np.array([names.index(what) for what in told])
            self._numbers.append(first[doing[np.minimum(steps + 1, len(doing) - 1), k]])

    def __call__(
        self, scene: Scene, grippers: Mapping[int, float]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(N,) the number of each agent's subgoal and (N,) whether it may go on, in the scene that is now.

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
        """Where on its path an agent is now."""
        at, path, knots = int(self._at[k]), self._paths[k], self._knots[k]
        now = hand(self._arms[k], qpos)
        moved_m = np.linalg.norm(now - self._were[k], axis=-1).mean()
        self._were[k], self._stood[k] = now, self._stood[k] + 1 if moved_m < STILL_M else 0
        ahead = path[at : at + AHEAD_STEPS + 1]
        alike = (gripper_of(ahead) > 0) == (gripper > 0)
        if not alike[0]:  # told earlier, or later, than the plan has it
            return at + int(np.argmax(alike))
        if not alike.all():  # a gripper has to change before its arm gets on with what is behind that
            ahead = ahead[: int(np.argmin(alike))]
        away = self._hands[k][at : at + len(ahead)] - now
        off_m = np.linalg.norm(away, axis=-1).mean(axis=-1)
        near = at + int(np.flatnonzero(off_m <= off_m.min() + NEAREST_M)[-1])
        end = int(knots[np.searchsorted(knots, near)])
        if end >= at + len(ahead):
            return near
        # A motion ends slowly: who hangs back by millimetres under a load lacks more than a few steps.
        if end - near <= REACHED_STEPS or off_m[end - at] <= REACHED_M:
            return end
        # One that is disturbed waits a little beside where it has to.
        waits = np.count_nonzero(self._positions[:, k] == end) > 1 and self._stood[k] >= STOOD_STEPS
        return end if waits and off_m[end - at] <= STOOD_M else near

    def _free(self, k: int) -> bool:
        """Whether an agent that stands between two segments may begin the next."""
        knots = self._knots[k]
        at = knots[np.searchsorted(knots, self._at[k], side="right") - 1]
        if at == knots[-1]:  # until all have come to the end of the plan
            return False
        if self._at[k] - at > REACHED_STEPS:  # it is on its way
            return True
        # Also where the plan has no wait: the others may be later than it has them.
        leaves = int(np.searchsorted(self._positions[:, k], at, side="right"))  # the step that leads on
        needed = self._positions[leaves - 1] - SLACK_STEPS
        others = np.arange(len(needed)) != k
        return bool((self._at >= needed)[others].all())


def hand(arm: Arm, qpos: Floats) -> Floats:
    """(..., 4, 3) m, in the world: the points of an arm's hand that tell where it is and how it is turned."""
    return placed(arm.tcp(qpos), HAND_M)
