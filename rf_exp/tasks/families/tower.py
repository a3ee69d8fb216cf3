"""Tower: arms in a circle take turns to stack their cubes at its centre."""

from itertools import product
from typing import Any

from rf_exp.errors import ArgumentError
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.shared import circle, stacking
from rf_exp.tasks.shared.circle import Numbers
from rf_exp.types import Condition, Scene

VERSION = "2"
PLAN_VERSION = "1"


def layout(
    arms: int,
    things: int,
    *,
    radius_m: float,
    start: Numbers,
    goal_radius_m: float,
    most_cubes: int,
    step_limit: Numbers,
) -> dict[str, Any]:
    """Cubes side by side before each arm, a goal at the centre. Raises ArgumentError for a tower too high."""
    if arms * things > most_cubes:
        raise ArgumentError(
            f"a tower of {arms} x {things} cubes is higher than the arms can build; expected at most "
            f"{most_cubes} in all"
        )
    objects = {"goal": circle.goal_at(0.0, 0.0, goal_radius_m)}
    for k, arm in product(range(things), range(1, arms + 1)):
        objects[f"cube{arm}_{k + 1}"] = circle.cube(arm, arms, k, things, radius_m, **start)
    limit = step_limit["first"] + arms * things * step_limit["each"]
    return {**circle.robots_and_cameras(arms, radius_m), "objects": objects, "step_limit": limit}


def plan(scene: Scene, task: Task) -> Proposal:
    """All arms fetch their cubes; each is placed once the one below it is in place."""
    cubes = (name for name in task.objects if name != "goal")
    return stacking.plan(scene, task, {name: circle.agent_of_object(name) for name in cubes})


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each cube is in its place, level, released and at rest."""
    return stacking.conditions(scene, task, [name for name in task.objects if name != "goal"])
