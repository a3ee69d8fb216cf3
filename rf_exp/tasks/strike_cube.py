"""Strike Cube: one arm takes the hammer by its handle and strikes the cube."""

from math import dist

from rf_exp.statements import AvoidObjects, Proposal, grasping
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, every, upright
from rf_exp.tasks.shared import striking
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the handle, lift, bring the head down on the cube."""
    if striking.struck(scene, task, ARM):
        return Proposal((), ())
    subgoals = tuple(striking.take_and_strike(scene, ARM))
    return Proposal(subgoals, (*grasping(subgoals), AvoidObjects(ARM)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The held hammer rests on the cube with its face down, and the cube has not moved."""
    limits = task.success
    slipped_m = dist(scene.poses["cube"][:3, 3].tolist(), start.poses["cube"][:3, 3].tolist())
    unmoved = every((below(slipped_m, limits["slip_m"], "m"), upright(scene, "cube", limits["face_deg"])))
    return {**striking.conditions(scene, task, ARM), "cube where it was": unmoved}


paper = striking.paper
