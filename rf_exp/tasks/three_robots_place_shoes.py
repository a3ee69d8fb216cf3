"""Three Robots Place Shoes: two arms put a shoe each into a box, the third sweeps its lid shut."""

from rf_exp.statements import ContactAt, Direction, Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, every, height_m, near, released, set_down, still
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.types import Condition, Measured, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

SHOES = {"left_shoe": (1, "left"), "right_shoe": (2, "right")}  # shoe -> (agent, drop point of the box)
SWEEPER = 3


def plan(scene: Scene, task: Task) -> Proposal:
    """Put both shoes into the box, then sweep the lid shut."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    for shoe, (agent, side) in SHOES.items():
        if not _inside(scene, task, shoe) or not released(scene, [shoe]):
            subgoals += pick_and_place(agent, shoe, "box", side)
            constraints += in_turn(Step(agent, "place", shoe), Step(SWEEPER, "shut", "lid"))
    grasps = grasping(subgoals)
    if not subgoals and _closed(scene, task):
        return Proposal((), ())
    subgoals.append(Subgoal(SWEEPER, "shut", "lid", "top"))
    sweeps = [ContactAt(SWEEPER, "shut", "lid", "top"), Direction(SWEEPER, "lid")]
    return Proposal(tuple(subgoals), (*grasps, *sweeps, *constraints, *keep_clear(task.agents)))


def _inside(scene: Scene, task: Task, shoe: str) -> Measured:
    size, limits = task.objects["box"].size, task.success
    beside = near(scene, shoe, "box", size * limits["inside_m"])
    return every((beside, below(height_m(scene, shoe), size * limits["low_m"], "m")))


def _closed(scene: Scene, task: Task) -> Measured:
    return below(abs(float(task.hinge_rad("lid", scene.poses))), task.success["shut_rad"], "rad")


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Both shoes stand upright in the box, released and at rest; the lid is shut and at rest."""
    return {
        "shoes in the box": every(_inside(scene, task, shoe) for shoe in SHOES),
        "lid shut": every((_closed(scene, task), still(scene, "lid", task.success["still_m_s"]))),
        **set_down(scene, SHOES, task.success),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: both shoes are low, near the box and released, and the lid is shut."""
    limits = task.success
    low = all(height_m(scene, shoe) < limits["paper_height_m"] for shoe in SHOES)
    by = all(near(scene, shoe, "box", limits["paper_distance_m"]) for shoe in SHOES)
    return low and by and released(scene, SHOES) and bool(_closed(scene, task))
