"""Whether an episode has succeeded, step by step."""

from collections.abc import Mapping
from math import hypot

from rf_exp.tasks.task.task import Task
from rf_exp.types import Condition, Measured, Scene, Verdict

OFF_M = 0.05  # below the top of the table
DROP_M = 0.05  # that a thing falls after it was let go; what is set down sinks by millimetres


class SuccessEvaluator:
    """Judges one episode, step by step: strict conditions must all hold for several steps."""

    def __init__(self, task: Task, start: Scene) -> None:
        self._task, self._start, self._steps = task, start, 0
        self._module = task.module
        self._reaches_m = [(robot.x_m, robot.y_m, robot.model.reach_m) for robot in task.robots]
        self._hold_steps = int(task.success["hold_steps"])
        self._let_go_m: dict[str, float] = {}  # object -> its height when it was held last
        places = {name: start.poses[name][:2, 3].tolist() for name in task.objects}
        self._reached = frozenset(name for name, place in places.items() if self._in_reach(*place))

    def __call__(self, scene: Scene) -> Verdict:
        conditions: Mapping[str, Condition] = self._module.conditions(scene, self._start, self._task)
        evidence = {name: bool(holds) for name, holds in conditions.items()}
        self._steps = self._steps + 1 if all(evidence.values()) else 0
        return Verdict(
            self._steps >= self._hold_steps,
            bool(self._module.paper(scene, self._start, self._task)),
            evidence,
            {name: found for name, found in conditions.items() if isinstance(found, Measured)},
            self._lost(scene),
        )

    def _lost(self, scene: Scene) -> dict[str, str]:
        """What no arm can get at any more, and what fell out of a hand."""
        lost = {}
        for name in self._task.objects:
            x_m, y_m, height_m = scene.poses[name][:3, 3].tolist()
            if name in scene.held:
                self._let_go_m[name] = height_m
            if height_m < -OFF_M:
                lost[name] = "off the table"
            elif name in self._reached and not self._in_reach(x_m, y_m):
                lost[name] = "out of reach"
            elif self._let_go_m.get(name, height_m) - height_m > DROP_M:
                lost[name] = "dropped"
        return lost

    def _in_reach(self, x_m: float, y_m: float) -> bool:
        return any([hypot(x_m - base_x, y_m - base_y) < reach for base_x, base_y, reach in self._reaches_m])
