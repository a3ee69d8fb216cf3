"""Pick Meat: one arm picks up a piece of meat and lifts it."""

from rf_exp.statements import AvoidObjects, Proposal, grasping
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import above, height_m, holders, risen_m, still
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1
LIFT_M = 0.17  # slightly more than the required rise


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the steak across its middle and lift it."""
    up = height_m(scene, "steak") > task.success["lift_m"]
    if up and holders(scene, "steak"):
        return Proposal((), ())
    subgoals = (Subgoal(ARM, "grasp", "steak", "center"), Subgoal(ARM, "lift", "steak", height_m=LIFT_M))
    return Proposal(subgoals, (*grasping(subgoals), AvoidObjects(ARM)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The arm holds the steak, which is lifted and at rest."""
    return {
        "held": holders(scene, "steak") == (ARM,),
        "lifted": above(risen_m(scene, start, "steak"), task.success["lift_m"], "m"),
        "at rest": still(scene, "steak", task.success["still_m_s"]),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the steak is high enough."""
    return height_m(scene, "steak") > task.success["lift_m"]
