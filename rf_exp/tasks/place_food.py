"""Place Food: one arm takes the lid off the pot, the other puts the food in."""

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import at_rest, below, every, far, height_m, near, released, upright
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

COOK, HELPER = 1, 2  # agents: the first brings the food, the second opens the pot
LID_LIFT_M = 0.12
ASIDE_M = 0.27  # from the pot (at size 1) to the place of the lid, towards the helper


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """`aside`: world_from_object (4, 4) of the lid beside the pot."""
    pot = scene.poses["pot"]
    return {"aside": planar(pot[0, 3], pot[1, 3] + task.objects["pot"].size * ASIDE_M, 0.0)}


def plan(scene: Scene, task: Task) -> Proposal:
    """Lift the lid and put it aside while the steak is fetched; place the steak once the lid is lifted."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    if not _lid_off(scene, task) or not released(scene, ["lid"]):
        take, aside = pick_and_place(HELPER, "lid", "aside", grip="knob")
        subgoals += [take, Subgoal(HELPER, "lift", "lid", height_m=LID_LIFT_M), aside]
        constraints += grasping([take])
    if not _inside(scene, task) or not released(scene, ["steak"]):
        food = pick_and_place(COOK, "steak", "pot", "inside")
        subgoals, constraints = subgoals + food, constraints + grasping(food)
    if len({subgoal.agent for subgoal in subgoals}) == 2:
        constraints += in_turn(Step(HELPER, "lift", "lid"), Step(COOK, "place", "steak"))
    return Proposal(tuple(subgoals), (*constraints, *keep_clear(task.agents)))


def _inside(scene: Scene, task: Task) -> Condition:
    rim_m = height_m(scene, "pot") + float(task.asset("pot").bounds_m[1, 2])
    beside = near(scene, "steak", "pot", task.objects["pot"].size * task.success["inside_m"])
    return every((beside, below(height_m(scene, "steak"), rim_m, "m")))


def _lid_off(scene: Scene, task: Task) -> Condition:
    return far(scene, "lid", "pot", task.objects["pot"].size * task.success["lid_off_m"])


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The steak lies in the upright pot, the lid beside it; both are released, all objects at rest."""
    limits = task.success
    lid_down = below(height_m(scene, "lid"), limits["lid_down_m"], "m")
    return {
        "steak inside the pot": _inside(scene, task),
        "lid off": _lid_off(scene, task),
        "lid upright on the table": every((upright(scene, "lid", limits["upright_deg"]), lid_down)),
        "pot upright": upright(scene, "pot", limits["upright_deg"]),
        "released": released(scene, ["steak", "lid"]),
        "at rest": at_rest(scene, task.objects, limits),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the steak is low and near the pot."""
    low = height_m(scene, "steak") < task.success["paper_height_m"]
    return low and bool(near(scene, "steak", "pot", task.success["paper_distance_m"]))
