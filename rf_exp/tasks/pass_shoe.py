"""Pass Shoe: one arm puts the shoe down half-way, the other brings it to the goal."""

from rf_exp.statements import Proposal, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import near
from rf_exp.tasks.shared import shoe_on_goal
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Scene

VERSION = "1"
PLAN_VERSION = "1"

GIVER, TAKER = 1, 2
MIDWAY = (0.0, 0.0)  # x, y in m, within reach of both arms


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """`midway`: world_from_object (4, 4) of the shoe at the transfer."""
    return {"midway": planar(*MIDWAY, 0.0)}


def plan(scene: Scene, task: Task) -> Proposal:
    """The giver puts the shoe down midway and yields; the taker brings it to the goal."""
    if shoe_on_goal.done(scene, task):
        return Proposal((), ())
    give, take = pick_and_place(GIVER, "shoe", "midway"), pick_and_place(TAKER, "shoe", "goal", "middle")
    if near(scene, "shoe", task.places(scene)["midway"], task.success["goal_m"]) or scene.held[TAKER - 1]:
        return Proposal(tuple(take), (*grasping(take), *keep_clear(task.agents)))
    order = in_turn(Step(GIVER, "place", "shoe"), Step(TAKER, "grasp", "shoe"))
    return Proposal((*give, *take), (*grasping(give + take), *order, *keep_clear(task.agents)))


conditions, paper = shoe_on_goal.conditions, shoe_on_goal.paper
