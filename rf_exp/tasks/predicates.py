"""Named measurements on a scene, so that success criteria read in words."""

from collections.abc import Callable, Iterable, Mapping
from math import acos, degrees, hypot
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Condition, Measured, Scene

Found = TypeVar("Found")


def once(measure: Callable[[Scene, Task], Found]) -> Callable[[Scene, Task], Found]:
    """Measures each scene at the first call alone: for what conditions and the paper's criterion share."""
    last: tuple[Scene, Task, Found] | None = None

    def measured(scene: Scene, task: Task) -> Found:
        nonlocal last
        known = last
        if known is None or known[0] is not scene or known[1] is not task:
            last = known = scene, task, measure(scene, task)
        return known[2]

    return measured


def above(value: float, bound: float, unit: str) -> Measured:
    """Whether a value is above its bound."""
    return Measured(bool(value > bound), float(value), float(bound), unit, True)


def below(value: float, bound: float, unit: str) -> Measured:
    """Whether a value is below its bound."""
    return Measured(bool(value < bound), float(value), float(bound), unit, False)


def every(conditions: Iterable[Measured]) -> Measured:
    """Whether all of them hold: the first that does not, or else the last. At least one is needed."""
    for found in conditions:
        if not found:
            break
    return found


def height_m(scene: Scene, name: str) -> float:
    """Height of the object's origin above the table."""
    return float(scene.poses[name][2, 3])


def risen_m(scene: Scene, start: Scene, name: str) -> float:
    """How far the object's origin is above where it started."""
    return height_m(scene, name) - height_m(start, name)


def distance_xy_m(a: Matrix, b: Matrix) -> float:
    """Distance of two origins on the table."""
    return hypot(*(a[:2, 3] - b[:2, 3]).tolist())


def tilt_deg(pose: Matrix) -> float:
    """Angle between the object's z axis and the vertical."""
    return degrees(acos(min(max(float(pose[2, 2]), -1.0), 1.0)))


def still(scene: Scene, name: str, below_m_s: float) -> Measured:
    """Whether the object moves slower than a bound."""
    return below(scene.speeds[name], below_m_s, "m/s")


def at_rest(scene: Scene, names: Iterable[str], limits: Mapping[str, float]) -> Measured:
    """Whether all of the objects are still. Reads `still_m_s` of the task's thresholds."""
    return every(still(scene, name, limits["still_m_s"]) for name in names)


def holders(scene: Scene, name: str) -> tuple[int, ...]:
    """The agents that pinch the object between their fingers."""
    return tuple([agent for agent, held in enumerate(scene.held, start=1) if held == name])


def upright(scene: Scene, name: str, within_deg: float) -> Measured:
    """Whether the object's z axis is vertical."""
    return below(tilt_deg(scene.poses[name]), within_deg, "deg")


def on(scene: Scene, task: Task, top: str, bearer: str, beside_m: float) -> Measured:
    """Whether `top` lies on the point `top` of `bearer`, at most `beside_m` beside it.

    That bound is for things of the usual size, and is as much wider as `bearer` is larger. Reads `above_m`
    of the task's thresholds.
    """
    x_m, y_m, z_m = (scene.poses[top][:3, 3] - scene.poses[bearer][:3, 3]).tolist()
    beside_m, within_m = hypot(x_m, y_m), task.objects[bearer].size * beside_m
    if beside_m > within_m:
        return Measured(False, beside_m, within_m, "m", False)
    off_m, above_m = abs(z_m - float(task.points[bearer]["top"][2, 3])), task.success["above_m"]
    return Measured(off_m <= above_m, off_m, above_m, "m", False)


def released(scene: Scene, names: Iterable[str]) -> bool:
    """Whether nobody holds any of the objects."""
    return not any(name in scene.held for name in names)


def pushed_n(scene: Scene, agent: int, name: str, direction: NDArray[np.float64]) -> float:
    """Force of an agent's fingers on the object along a direction (3,) in the world."""
    return float(scene.finger_forces.get((agent, name), np.zeros(3)) @ direction)


def set_down(scene: Scene, names: Iterable[str], limits: Mapping[str, float]) -> dict[str, Condition]:
    """Conditions of things that have been put down: upright, let go, at rest.

    Reads `upright_deg` and `still_m_s` of the task's thresholds.
    """
    names = tuple(names)
    return {
        "upright": every(upright(scene, name, limits["upright_deg"]) for name in names),
        "released": released(scene, names),
        "at rest": at_rest(scene, names, limits),
    }


def raised(scene: Scene, start: Scene, name: str, limits: Mapping[str, float]) -> dict[str, Condition]:
    """Conditions of a thing that is held up: above where it started, level, at rest.

    Reads `lift_m`, `level_deg` and `still_m_s` of the task's thresholds.
    """
    return {
        "lifted": above(risen_m(scene, start, name), limits["lift_m"], "m"),
        "level": upright(scene, name, limits["level_deg"]),
        "at rest": still(scene, name, limits["still_m_s"]),
    }


def on_goal(scene: Scene, name: str, goal: str, limits: Mapping[str, float]) -> Measured:
    """Whether the object lies on the table at a mark.

    Reads `goal_m` and `above_m` of the task's thresholds.
    """
    down = below(height_m(scene, name), limits["above_m"], "m")
    return every((near(scene, name, goal, limits["goal_m"]), down))


def near(scene: Scene, name: str, target: str | Matrix, within_m: float) -> Measured:
    """Whether the object is that near to another one, or to a place, seen from above."""
    there = scene.poses[target] if isinstance(target, str) else target
    return below(distance_xy_m(scene.poses[name], there), within_m, "m")


def far(scene: Scene, name: str, other: str, beyond_m: float) -> Measured:
    """Whether the object is farther than that from another one, seen from above."""
    return above(distance_xy_m(scene.poses[name], scene.poses[other]), beyond_m, "m")
