"""Camera Alignment: two arms lift the camera, a third holds the steak in front of its lens."""

from rf_exp.statements import Proposal, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.shared import held_camera
from rf_exp.types import Scene

VERSION = "1"
PLAN_VERSION = "1"

places = held_camera.places


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the camera on both sides and the steak; lift the camera, carry the steak in front of it."""
    subgoals = held_camera.camera_up(scene, task) + held_camera.steak_in_front(scene, task)
    if not subgoals:
        return Proposal((), ())
    return Proposal(tuple(subgoals), (*held_camera.constraints(subgoals), *keep_clear(task.agents)))


conditions, paper = held_camera.conditions, held_camera.paper
