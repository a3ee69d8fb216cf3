"""Predicates and measurements on a scene, from which success criteria are composed."""

from collections.abc import Callable, Iterable, Mapping
from math import acos, degrees, hypot
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Condition, Measured, Scene

T = TypeVar("T")


def once(measure: Callable[[Scene, Task], T]) -> Callable[[Scene, Task], T]:
    """Caches the measurement of the last scene, which conditions and the paper's criterion share."""
    last: tuple[Scene, Task, T] | None = None

    def measured(scene: Scene, task: Task) -> T:
        nonlocal last
        cached = last
        if cached is None or cached[0] is not scene or cached[1] is not task:
            last = cached = scene, task, measure(scene, task)
        return cached[2]

    return measured


def above(value: float, bound: float, unit: str) -> Measured:
    """Whether a value is above its bound."""
    return Measured(bool(value > bound), float(value), float(bound), unit, True)


def below(value: float, bound: float, unit: str) -> Measured:
    """Whether a value is below its bound."""
    return Measured(bool(value < bound), float(value), float(bound), unit, False)


def every(conditions: Iterable[Measured]) -> Measured:
    """The first condition that does not hold, or else the last one. At least one is needed."""
    for condition in conditions:
        if not condition:
            break
    return condition


def height_m(scene: Scene, name: str) -> float:
    """Height of the object's origin above the table top."""
    return float(scene.poses[name][2, 3])


def risen_m(scene: Scene, start: Scene, name: str) -> float:
    """Height of the object's origin above its start."""
    return height_m(scene, name) - height_m(start, name)


def distance_xy_m(a: Matrix, b: Matrix) -> float:
    """Horizontal distance between the origins of two poses."""
    return hypot(*(a[:2, 3] - b[:2, 3]).tolist())


def tilt_deg(pose: Matrix) -> float:
    """Angle between the object's z axis and the vertical."""
    return degrees(acos(min(max(float(pose[2, 2]), -1.0), 1.0)))


def still(scene: Scene, name: str, below_m_s: float) -> Measured:
    """Whether the object moves slower than a bound."""
    return below(scene.speeds[name], below_m_s, "m/s")


def at_rest(scene: Scene, names: Iterable[str], limits: Mapping[str, float]) -> Measured:
    """Whether all of the objects are still. Reads the threshold `still_m_s`."""
    return every(still(scene, name, limits["still_m_s"]) for name in names)


def holders(scene: Scene, name: str) -> tuple[int, ...]:
    """The agents that hold the object between their fingers."""
    return tuple([agent for agent, held in enumerate(scene.held, start=1) if held == name])


def upright(scene: Scene, name: str, within_deg: float) -> Measured:
    """Whether the object's z axis is vertical."""
    return below(tilt_deg(scene.poses[name]), within_deg, "deg")


def on(scene: Scene, task: Task, top: str, bearer: str, beside_m: float) -> Measured:
    """Whether object `top` lies on the place point `top` of `bearer`, at most `beside_m` off horizontally.

    The horizontal bound scales with the size of `bearer`. Reads the threshold `above_m`.
    """
    x_m, y_m, z_m = (scene.poses[top][:3, 3] - scene.poses[bearer][:3, 3]).tolist()
    beside_m, within_m = hypot(x_m, y_m), task.objects[bearer].size * beside_m
    if beside_m > within_m:
        return Measured(False, beside_m, within_m, "m", False)
    off_m, above_m = abs(z_m - float(task.points[bearer]["top"][2, 3])), task.success["above_m"]
    return Measured(off_m <= above_m, off_m, above_m, "m", False)


def released(scene: Scene, names: Iterable[str]) -> bool:
    """Whether no agent holds any of the objects."""
    return not any(name in scene.held for name in names)


def pushed_n(scene: Scene, agent: int, name: str, direction: NDArray[np.float64]) -> float:
    """Force of an agent's fingers on the object along a direction (3,) in the world."""
    return float(scene.finger_forces.get((agent, name), np.zeros(3)) @ direction)


def set_down(scene: Scene, names: Iterable[str], limits: Mapping[str, float]) -> dict[str, Condition]:
    """Conditions of objects that have been put down: upright, released, at rest.

    Reads the thresholds `upright_deg` and `still_m_s`.
    """
    names = tuple(names)
    return {
        "upright": every(upright(scene, name, limits["upright_deg"]) for name in names),
        "released": released(scene, names),
        "at rest": at_rest(scene, names, limits),
    }


def raised(scene: Scene, start: Scene, name: str, limits: Mapping[str, float]) -> dict[str, Condition]:
    """Conditions of an object that is held up: above its start, level, at rest.

    Reads the thresholds `lift_m`, `level_deg` and `still_m_s`.
    """
    return {
        "lifted": above(risen_m(scene, start, name), limits["lift_m"], "m"),
        "level": upright(scene, name, limits["level_deg"]),
        "at rest": still(scene, name, limits["still_m_s"]),
    }


def on_goal(scene: Scene, name: str, goal: str, limits: Mapping[str, float]) -> Measured:
    """Whether the object lies on the table at a goal.

    Reads the thresholds `goal_m` and `above_m`.
    """
    down = below(height_m(scene, name), limits["above_m"], "m")
    return every((near(scene, name, goal, limits["goal_m"]), down))


def near(scene: Scene, name: str, target: str | Matrix, within_m: float) -> Measured:
    """Whether the horizontal distance to another object, or to a pose, is below a bound."""
    pose = scene.poses[target] if isinstance(target, str) else target
    return below(distance_xy_m(scene.poses[name], pose), within_m, "m")


def far(scene: Scene, name: str, other: str, beyond_m: float) -> Measured:
    """Whether the horizontal distance to another object is above a bound."""
    return above(distance_xy_m(scene.poses[name], scene.poses[other]), beyond_m, "m")
