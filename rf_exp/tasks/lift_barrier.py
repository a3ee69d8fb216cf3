"""Lift Barrier: two arms grasp both ends of a long barrier and lift it level."""

from rf_exp.statements import Proposal, SameHeight, Together, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import height_m, holders, raised, risen_m
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

GRIPS = {1: "left", 2: "right"}  # the end nearest to each arm
LIFT_M = 0.17  # lift of both grippers: slightly more than the required rise


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp both ends; once both are held, lift them at the same time."""
    if height_m(scene, "barrier") > task.success["lift_m"] and holders(scene, "barrier") == task.agents:
        return Proposal((), ())
    spatial = keep_clear(task.agents)
    if len(holders(scene, "barrier")) < len(task.agents):
        grasps = tuple(Subgoal(agent, "grasp", "barrier", point) for agent, point in GRIPS.items())
        return Proposal(grasps, (*grasping(grasps), Together((1, 2), "grasp", "barrier", 2.0), *spatial))
    return Proposal(
        tuple(Subgoal(agent, "lift", "barrier", height_m=LIFT_M) for agent in GRIPS),
        (SameHeight((1, 2)), Together((1, 2), "lift", "barrier"), *spatial),
    )


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Both arms hold the barrier, which is lifted, level and at rest."""
    held = holders(scene, "barrier") == task.agents
    return {"held by both arms": held, **raised(scene, start, "barrier", task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the centre has risen by more than the threshold."""
    return risen_m(scene, start, "barrier") > task.success["lift_m"]
