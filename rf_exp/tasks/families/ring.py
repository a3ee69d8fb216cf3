"""Ring: each arm of a circle brings its own things to spots in the middle, beside its neighbours'."""

from collections.abc import Mapping
from itertools import product
from typing import Any

from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import every, on_goal, released, set_down
from rf_exp.tasks.shared import circle
from rf_exp.tasks.shared.placing import fetch
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"


def layout(
    arms: int,
    things: int,
    *,
    radius_m: float,
    start: Mapping[str, float],
    spot_m: Mapping[str, float],
    step_limit: Mapping[str, int],
) -> dict[str, Any]:
    """Things side by side before each arm, and their spots in a row from the middle outwards."""
    objects: dict[str, Any] = {}
    for arm, k in product(range(1, arms + 1), range(things)):
        forward_m = radius_m - spot_m["middle"] - k * spot_m["apart"]
        spot = circle.before(arm, arms, radius_m, forward_m)
        objects[f"goal{arm}_{k + 1}"] = {"asset": "goal", "options": {"radius_m": spot_m["radius"]}, **spot}
    for arm, k in product(range(1, arms + 1), range(things)):
        objects[f"cube{arm}_{k + 1}"] = circle.cube(arm, arms, k, things, radius_m, **start)
    limit = step_limit["first"] + things * step_limit["each"]
    return {**circle.around(arms, radius_m), "objects": objects, "step_limit": limit}


def _pairs(task: Task) -> list[tuple[int, str, str]]:
    """Agents, their cubes and the spots of these; of one agent that in the middle first."""
    cubes = [name for name in task.objects if name.startswith("cube")]
    numbers = [circle.number(name) for name in cubes]
    return [(agent, cube, f"goal{number}") for (agent, number), cube in zip(numbers, cubes, strict=True)]


def plan(scene: Scene, task: Task) -> Proposal:
    """Every arm brings its things to their spots, one after the other."""
    subgoals: list[Subgoal] = []
    for agent, cube, goal in _pairs(task):
        if not on_goal(scene, cube, goal, task.success) or not released(scene, [cube]):
            subgoals += fetch(agent, cube, goal, "middle")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *keep_clear(task.agents)) if subgoals else ())


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each thing is on its spot, upright, let go and at rest."""
    pairs = _pairs(task)
    there = every(on_goal(scene, cube, goal, task.success) for _, cube, goal in pairs)
    return {"things on their spots": there, **set_down(scene, [cube for _, cube, _ in pairs], task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The paper does not know this task; its criterion is ours, without the steps that it must hold."""
    return all(conditions(scene, start, task).values())
