"""Sizes of objects, which differ from scene to scene: each has one, against its usual one."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rf_exp.tasks.task.task import Task

SMALLEST, LARGEST = 0.5, 1.5
FINGER_ROOM_M = 0.006  # that a finger has beside what it closes on
HAND_ROOM_M = 0.008  # that is left between a thing and a hand at rest over it
TIP_M = 0.011  # of fingers, beyond the TCP


def sizes_of(task: "Task", between: tuple[float, float], rng: np.random.Generator) -> dict[str, float]:
    """Object -> its size, drawn between two.

    What stands on another one is of one size with it, and a mark on the table has its usual one. None is so
    large that a hand does not open wide enough for it, or meets it where it rests.
    """
    drawn = {name: float(rng.uniform(*between)) for name in task.objects}
    if between == (1.0, 1.0):
        return drawn
    bearer: dict[str, str] = {}
    for name, spec in task.objects.items():
        bearer[name] = name if spec.stands_on is None else bearer[spec.stands_on]
    largest = {
        one: max(1.0, min(_largest(task, name) for name in task.objects if bearer[name] == one))
        for one in bearer.values()
    }
    return {
        name: min(drawn[one], largest[one]) if task.asset(name).hulls else 1.0 for name, one in bearer.items()
    }


def _largest(task: "Task", name: str) -> float:
    """The size of an object at which hands just open wide enough, and just rest clear of it."""
    asset, spec = task.asset(name), task.objects[name]
    if not asset.hulls:
        return np.inf
    open_m = 2 * min(robot.model.hand.open_m - FINGER_ROOM_M for robot in task.robots)
    widths_m = [point.width_m for point in asset.points.values() if point.kind == "grasp"]
    found = [open_m / width_m for width_m in widths_m]
    top_m = spec.z_m + float(asset.bounds_m[1, 2])
    across_m = float(np.linalg.norm(asset.bounds_m[:, :2], axis=1).max())
    first = spec
    while first.relative_to is not None:
        first = task.objects[first.relative_to]
    for robot, arm in zip(task.robots, task.arms.values(), strict=True):
        x_m, y_m, z_m = arm.tcp(robot.at_rest)[:3, 3].tolist()
        beside = (max(low - at, at - high) for at, (low, high) in ((x_m, first.x_m), (y_m, first.y_m)))
        if max(beside) < across_m:
            found.append((z_m - TIP_M - HAND_ROOM_M) / top_m)
    return min(found, default=np.inf)
