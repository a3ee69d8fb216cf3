"""Ring: arms in a circle bring their own objects to spots near the centre, side by side."""

from itertools import product
from typing import Any

from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.shared import circle
from rf_exp.tasks.shared.circle import Numbers
from rf_exp.tasks.shared.placing import delivered_conditions, pick_and_place, undelivered_cubes
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "2"
PLAN_VERSION = "1"


def layout(
    arms: int, things: int, *, radius_m: float, start: Numbers, spot_m: Numbers, step_limit: Numbers
) -> dict[str, Any]:
    """Objects side by side before each arm, and their spots in a row from the centre outwards."""
    objects: dict[str, Any] = {}
    for arm, k in product(range(1, arms + 1), range(things)):
        forward_m = radius_m - spot_m["middle"] - k * spot_m["apart"]
        spot = circle.in_front_of_arm(arm, arms, radius_m, forward_m)
        objects[f"goal{arm}_{k + 1}"] = {"asset": "goal", "options": {"radius_m": spot_m["radius"]}, **spot}
    for arm, k in product(range(1, arms + 1), range(things)):
        objects[f"cube{arm}_{k + 1}"] = circle.cube(arm, arms, k, things, radius_m, **start)
    limit = step_limit["first"] + things * step_limit["each"]
    return {**circle.robots_and_cameras(arms, radius_m), "objects": objects, "step_limit": limit}


def plan(scene: Scene, task: Task) -> Proposal:
    """Each arm brings its objects to their spots one after the other, innermost first."""
    subgoals: list[Subgoal] = []
    for cube, goal in undelivered_cubes(scene, task).items():
        subgoals += pick_and_place(circle.agent_of_object(cube), cube, goal, "middle")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *keep_clear(task.agents)) if subgoals else ())


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each object is on its spot, upright, released and at rest."""
    return delivered_conditions(scene, task, "things on their spots")
