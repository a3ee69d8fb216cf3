"""Camera Alignment: two arms lift the camera, a third holds the steak where the camera looks."""

from rf_exp.statements import Proposal, keep_clear
from rf_exp.tasks.shared import held_camera
from rf_exp.tasks.task import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """`front`: where the steak is in the middle of the picture once the camera is up."""
    return held_camera.places(scene, task)


def plan(scene: Scene, task: Task) -> Proposal:
    """Both sides of the camera and the steak are grasped; up goes the camera, in front of it the steak."""
    subgoals = held_camera.camera_up(scene, task) + held_camera.steak_in_front(scene, task)
    if not subgoals:
        return Proposal((), ())
    return Proposal(tuple(subgoals), (*held_camera.constraints(subgoals), *keep_clear(task.agents)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The camera is held by both sides, up and level; the steak is held, up and in its picture."""
    return held_camera.conditions(scene, task)


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: both are high enough; it does not look at the alignment."""
    return held_camera.paper(scene, task)
