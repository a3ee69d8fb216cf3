"""Pool: a circle of arms and things that belong to nobody; who takes which is chosen in every scene."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import every, holders, on_goal, set_down
from rf_exp.tasks.shared import circle
from rf_exp.tasks.shared.placing import fetch
from rf_exp.types import ANYBODY, Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"


def layout(
    arms: int,
    things: int,
    *,
    radius_m: float,
    start: Mapping[str, float],
    goal: Mapping[str, float],
    step_limit: Mapping[str, int],
) -> dict[str, Any]:
    """Things in a circle, and their goals in one within it, each some way farther round."""
    objects: dict[str, Any] = {}
    between = circle.angle_rad(1, arms) + np.pi / arms  # the first thing stands between two arms
    angles = between + 2 * np.pi * np.arange(things) / things
    for k, angle in enumerate(angles + np.deg2rad(goal["turn_deg"]), start=1):
        x_m, y_m = (float(goal["radius_m"] * along(angle)) for along in (np.cos, np.sin))
        objects[f"goal{k}"] = {
            "asset": "goal",
            "options": {"radius_m": goal["mark_m"]},
            "x_m": x_m,
            "y_m": y_m,
        }
    for k, angle in enumerate(angles, start=1):
        x_m, y_m = (float(start["radius_m"] * along(angle)) for along in (np.cos, np.sin))
        objects[f"cube{k}"] = circle.cube_at(x_m, y_m, start["jitter_m"], k)
    limit = step_limit["first"] + things * step_limit["each_thing"]
    return {**circle.around(arms, radius_m), "objects": objects, "step_limit": limit}


def _pairs(task: Task) -> list[tuple[str, str]]:
    return [(f"cube{k}", f"goal{k}") for k in range(1, len(task.objects) // 2 + 1)]


def plan(scene: Scene, task: Task) -> Proposal:
    """Somebody brings each thing to its goal; who holds one already goes on with it."""
    subgoals: list[Subgoal] = []
    for cube, goal in _pairs(task):
        held = holders(scene, cube)
        if held or not on_goal(scene, cube, goal, task.success):
            subgoals += fetch(held[0] if held else ANYBODY, cube, goal, "middle")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *keep_clear(task.agents)) if subgoals else ())


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each thing is on its goal, upright, let go and at rest."""
    there = every(on_goal(scene, cube, goal, task.success) for cube, goal in _pairs(task))
    cubes = [cube for cube, _ in _pairs(task)]
    return {"things on their goals": there, **set_down(scene, cubes, task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The paper does not know this task; its criterion is ours, without the steps that it must hold."""
    return all(conditions(scene, start, task).values())
