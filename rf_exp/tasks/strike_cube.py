"""Strike Cube: one arm takes the hammer by its handle and strikes the cube."""

from math import degrees, dist

from rf_exp.statements import AvoidObjects, Proposal, grasping
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, every, holders, once, upright
from rf_exp.transforms import angle_between_rad
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1
LIFT_M = 0.06  # off the table, before the hammer swings over the cube
DOWN = (0.0, 0.0, -1.0)


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the handle, lift, bring the head down on the cube."""
    held = holders(scene, "hammer") == (ARM,)
    if held and _face(scene, task)[0] < task.success["struck_m"]:
        return Proposal((), ())
    strike = Subgoal(ARM, "strike", "hammer", "head", target="cube", target_point="top")
    take = (Subgoal(ARM, "grasp", "hammer", "handle"), Subgoal(ARM, "lift", "hammer", height_m=LIFT_M))
    subgoals = (strike,) if held else (*take, strike)
    return Proposal(subgoals, (*grasping(subgoals), AvoidObjects(ARM)))


@once
def _face(scene: Scene, task: Task) -> tuple[float, list[float]]:
    """Of the striking face: from its middle to that of the cube's top, in m, and which way it strikes."""
    # `dot` is `@` in less than half of the time, which counts in every control step.
    head = scene.poses["hammer"].dot(task.points["hammer"]["head"])
    top = scene.poses["cube"].dot(task.points["cube"]["top"])
    return dist(head[:3, 3].tolist(), top[:3, 3].tolist()), head[:3, 2].tolist()


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The held hammer stands on the cube with its face down, and the cube is where it was."""
    limits, (gap_m, way) = task.success, _face(scene, task)
    slipped_m = dist(scene.poses["cube"][:3, 3].tolist(), start.poses["cube"][:3, 3].tolist())
    return {
        "hammer held": holders(scene, "hammer") == (ARM,),
        "face on the cube": below(gap_m, limits["struck_m"], "m"),
        "face down": below(degrees(angle_between_rad(way, DOWN)), limits["face_deg"], "deg"),
        "cube where it was": every(
            (below(slipped_m, limits["slip_m"], "m"), upright(scene, "cube", limits["face_deg"]))
        ),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the hammer's head is near the top of the cube."""
    return _face(scene, task)[0] < task.success["paper_gap_m"]
