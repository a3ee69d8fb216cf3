"""Pool: arms in a circle and unassigned objects; the agent of each object is chosen in every scene."""

from typing import Any

import numpy as np

from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders
from rf_exp.tasks.shared import circle
from rf_exp.tasks.shared.circle import Numbers
from rf_exp.tasks.shared.placing import delivered_conditions, pick_and_place, undelivered_cubes
from rf_exp.types import ANY_AGENT, Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"


def layout(
    arms: int, things: int, *, radius_m: float, start: Numbers, goal: Numbers, step_limit: Numbers
) -> dict[str, Any]:
    """Objects on a circle, and their goals on a second circle, each turned by a fixed angle."""
    objects: dict[str, Any] = {}
    between = circle.angle_rad(1, arms) + np.pi / arms  # the first object is between two arms
    angles = between + 2 * np.pi * np.arange(things) / things
    for k, angle in enumerate(angles + np.deg2rad(goal["turn_deg"]), start=1):
        x_m, y_m = (float(goal["radius_m"] * along(angle)) for along in (np.cos, np.sin))
        objects[f"goal{k}"] = circle.goal_at(x_m, y_m, goal["mark_m"])
    for k, angle in enumerate(angles, start=1):
        x_m, y_m = (float(start["radius_m"] * along(angle)) for along in (np.cos, np.sin))
        objects[f"cube{k}"] = circle.cube_at(x_m, y_m, start["jitter_m"], k)
    limit = step_limit["first"] + things * step_limit["each_thing"]
    return {**circle.robots_and_cameras(arms, radius_m), "objects": objects, "step_limit": limit}


def plan(scene: Scene, task: Task) -> Proposal:
    """Any agent brings each object to its goal; one that already holds an object keeps it."""
    subgoals: list[Subgoal] = []
    for cube, goal in undelivered_cubes(scene, task).items():
        agent, *_ = (*holders(scene, cube), ANY_AGENT)
        subgoals += pick_and_place(agent, cube, goal, "middle")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *keep_clear(task.agents)) if subgoals else ())


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each object is on its goal, upright, released and at rest."""
    return delivered_conditions(scene, task, "things on their goals")
