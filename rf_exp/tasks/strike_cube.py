"""Strike Cube: one arm takes the hammer by its handle and strikes the cube."""

from math import degrees, dist

import numpy as np

from rf_exp.statements import AvoidObjects, Proposal, grasping
from rf_exp.tasks.predicates import below, every, holders, upright
from rf_exp.tasks.task import Task
from rf_exp.transforms import Matrix, angle_between_rad
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1
LIFT_M = 0.06  # off the table, before the hammer swings over the cube
DOWN = np.array([0.0, 0.0, -1.0])


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the handle, lift, bring the head down on the cube."""
    held = holders(scene, "hammer") == (ARM,)
    if held and _gap_m(scene, task, _head(scene, task)) < task.success["struck_m"]:
        return Proposal((), ())
    strike = Subgoal(ARM, "strike", "hammer", "head", target="cube", target_point="top")
    take = (
        Subgoal(ARM, "grasp", "hammer", "handle"),
        Subgoal(ARM, "lift", "hammer", height_m=LIFT_M),
    )
    subgoals = (strike,) if held else (*take, strike)
    return Proposal(subgoals, (*grasping(subgoals), AvoidObjects(ARM)))


def _head(scene: Scene, task: Task) -> Matrix:
    """world_from_head: the middle of the striking face, z where it strikes."""
    return scene.poses["hammer"] @ task.asset("hammer").points["head"].object_from_tcp


def _gap_m(scene: Scene, task: Task, head: Matrix) -> float:
    """From the face of the hammer to the middle of the cube's top."""
    top = scene.poses["cube"] @ task.asset("cube").points["top"].object_from_tcp
    return dist(head[:3, 3].tolist(), top[:3, 3].tolist())


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The held hammer stands on the cube with its face down, and the cube is where it was."""
    limits, head = task.success, _head(scene, task)
    slipped_m = dist(scene.poses["cube"][:3, 3].tolist(), start.poses["cube"][:3, 3].tolist())
    off_deg = degrees(angle_between_rad(head[:3, 2], DOWN))
    return {
        "hammer held": holders(scene, "hammer") == (ARM,),
        "face on the cube": below(_gap_m(scene, task, head), limits["struck_m"], "m"),
        "face down": below(off_deg, limits["face_deg"], "deg"),
        "cube where it was": every(
            (below(slipped_m, limits["slip_m"], "m"), upright(scene, "cube", limits["face_deg"]))
        ),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the hammer's head is near the top of the cube."""
    return _gap_m(scene, task, _head(scene, task)) < task.success["paper_gap_m"]
