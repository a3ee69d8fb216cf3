"""Stack Cube: one arm puts the blue cube on the red one."""

from rf_exp.statements import AvoidObjects, Proposal, grasping
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import on, released, set_down
from rf_exp.tasks.shared.placing import pick_and_place
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the blue cube, place it on the red one."""
    if on(scene, task, "blue", "red", task.success["beside_m"]) and released(scene, task.objects):
        return Proposal((), ())
    subgoals = pick_and_place(ARM, "blue", "red", "top")
    return Proposal(tuple(subgoals), (*grasping(subgoals), AvoidObjects(ARM)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The blue cube lies on the red one, both level, released and at rest."""
    on_red = on(scene, task, "blue", "red", task.success["beside_m"])
    return {"blue on red": on_red, **set_down(scene, task.objects, task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> Condition:
    """The release's criterion: the blue cube is above the red one."""
    return on(scene, task, "blue", "red", task.success["paper_beside_m"])
