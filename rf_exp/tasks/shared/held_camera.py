"""A camera held by two arms and the steak in front of it: shared by Camera Alignment and Take Photo.

The task's objects are `camera`, on a plinth, and `steak`; agents 1 and 2 are at the sides of the camera,
agent 3 is in front of it.
"""

import numpy as np

from rf_exp.statements import SameHeight, Statement, Together, grasping
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import above, at_rest, below, height_m, holders, upright
from rf_exp.transforms import Matrix, angle_between_rad, transform
from rf_exp.types import Condition, Scene, Subgoal

LEFT, RIGHT = 1, 2  # agents at the sides of the camera
GRIPS = {LEFT: "left", RIGHT: "right"}
STEAK_HOLDER = 3  # agent that holds the steak
LIFTED_HEIGHT_M = 0.22  # height of the camera's underside, slightly more than required
STEAK_DISTANCE_M = 0.30  # from the lens to the steak


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """`front`: world_from_object (4, 4) of the steak in the middle of the raised camera's view."""
    lens = _lens(scene, task)
    target_m = lens[:3, 3] + STEAK_DISTANCE_M * lens[:3, 2]
    return {"front": transform((*target_m[:2], target_m[2] + _to_lift_m(scene, task) - _middle_m(task)))}


def camera_up(scene: Scene, task: Task) -> list[Subgoal]:
    """Remaining subgoals until both arms hold the camera up."""
    free = [agent for agent in GRIPS if scene.held[agent - 1] != "camera"]
    grasps = [Subgoal(agent, "grasp", "camera", GRIPS[agent]) for agent in free]
    up_m = round(_to_lift_m(scene, task), 3)
    return grasps + [Subgoal(agent, "lift", "camera", height_m=up_m) for agent in GRIPS if up_m]


def steak_in_front(scene: Scene, task: Task) -> list[Subgoal]:
    """Remaining subgoals until the steak is held on the axis of the lens."""
    carry = Subgoal(STEAK_HOLDER, "carry", "steak", target="front")
    if holders(scene, "steak") != (STEAK_HOLDER,):
        return [Subgoal(STEAK_HOLDER, "grasp", "steak", "center"), carry]
    return [] if aim_deg(scene, task) < task.success["aim_deg"] / 2 else [carry]


def constraints(subgoals: list[Subgoal]) -> list[Statement]:
    """Constraints: grasp as annotated; both arms lift the camera level and at the same time."""
    statements = grasping(subgoals)
    if any((subgoal.verb, subgoal.object) == ("lift", "camera") for subgoal in subgoals):
        statements += [SameHeight((LEFT, RIGHT)), Together((LEFT, RIGHT), "lift", "camera")]
    return statements


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Camera held by both arms, raised and level; steak held, raised and in its view; both at rest."""
    limits = task.success
    return {
        "camera held by both arms": holders(scene, "camera") == tuple(GRIPS),
        "camera up": above(height_m(scene, "camera"), limits["camera_up_m"], "m"),
        "camera level": upright(scene, "camera", limits["level_deg"]),
        "steak held": holders(scene, "steak") == (STEAK_HOLDER,),
        "steak up": above(height_m(scene, "steak"), limits["steak_up_m"], "m"),
        "camera points at the steak": below(aim_deg(scene, task), limits["aim_deg"], "deg"),
        "at rest": at_rest(scene, ("camera", "steak"), limits),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: both are high enough; alignment is not checked."""
    high = height_m(scene, "camera") > task.success["camera_up_m"]
    return high and height_m(scene, "steak") > task.success["steak_up_m"]


def aim_deg(scene: Scene, task: Task) -> float:
    """Angle between the lens axis and the line from the lens to the steak's middle."""
    lens, steak = _lens(scene, task), scene.poses["steak"]
    middle = steak[:3, 3] + _middle_m(task) * steak[:3, 2]
    return float(np.degrees(angle_between_rad(middle - lens[:3, 3], lens[:3, 2])))


def _to_lift_m(scene: Scene, task: Task) -> float:
    """Remaining lift of the camera; 0 once it is high enough and both arms hold it."""
    up_m = height_m(scene, "camera")
    if up_m > task.success["camera_up_m"] and holders(scene, "camera") == tuple(GRIPS):
        return 0.0
    return max(LIFTED_HEIGHT_M - up_m, 0.01)


def _lens(scene: Scene, task: Task) -> Matrix:
    """world_from_lens (4, 4), z along the viewing direction."""
    return scene.poses["camera"] @ task.points["camera"]["lens"]


def _middle_m(task: Task) -> float:
    """Height of the steak's middle above its origin."""
    low_m, high_m = task.asset("steak").bounds_m[:, 2].tolist()
    return (low_m + high_m) / 2
