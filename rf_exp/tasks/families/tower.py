"""Tower: the arms of a circle stack their cubes in its middle, one after the other, and again."""

from collections.abc import Mapping
from itertools import product
from typing import Any

from rf_exp.errors import ArgumentError
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.shared import circle, stacking
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"


def layout(
    arms: int,
    things: int,
    *,
    radius_m: float,
    start: Mapping[str, float],
    goal_radius_m: float,
    most_cubes: int,
    step_limit: Mapping[str, int],
) -> dict[str, Any]:
    """Cubes side by side before each arm, a goal in the middle. Raises ArgumentError for a tower too high."""
    if arms * things > most_cubes:
        raise ArgumentError(
            f"a tower of {arms} x {things} cubes is higher than the arms can build; expected at most "
            f"{most_cubes} in all"
        )
    goal = {"asset": "goal", "options": {"radius_m": goal_radius_m}, "x_m": 0.0, "y_m": 0.0}
    objects: dict[str, Any] = {"goal": goal}
    for k, arm in product(range(things), range(1, arms + 1)):
        objects[f"cube{arm}_{k + 1}"] = circle.cube(arm, arms, k, things, radius_m, **start)
    limit = step_limit["first"] + arms * things * step_limit["each"]
    return {**circle.around(arms, radius_m), "objects": objects, "step_limit": limit}


def _stack(task: Task) -> stacking.Stack:
    cubes = [name for name in task.objects if name != "goal"]
    return [(circle.number(name)[0], name) for name in cubes]


def plan(scene: Scene, task: Task) -> Proposal:
    """Everybody fetches a cube; each is placed once the one below it lies there."""
    return stacking.plan(scene, task, _stack(task))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each cube is in its place, level, let go and at rest."""
    return stacking.conditions(scene, task, _stack(task))


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The paper does not know this task; its criterion is ours, without the steps that it must hold."""
    return all(conditions(scene, start, task).values())
