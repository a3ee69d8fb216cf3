"""Take Photo: two arms hold up a camera, a third the steak in front of it, a fourth presses the shutter."""

import numpy as np

from rf_exp.statements import ContactAt, Direction, Proposal, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import pushed_n
from rf_exp.tasks.shared import held_camera
from rf_exp.transforms import Matrix, angle_between_rad
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

PHOTOGRAPHER = 4

places = held_camera.places


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp everything; lift the camera and carry the steak in front of it; then press the shutter."""
    preparation = held_camera.camera_up(scene, task) + held_camera.steak_in_front(scene, task)
    if preparation:
        subgoals = [subgoal for subgoal in preparation if subgoal.verb == "grasp"] or preparation
        constraints = held_camera.constraints(subgoals)
    elif _pressed(scene, task):
        return Proposal((), ())
    else:
        subgoals = [Subgoal(PHOTOGRAPHER, "press", "camera", "shutter")]
        constraints = [
            ContactAt(PHOTOGRAPHER, "press", "camera", "shutter"),
            Direction(PHOTOGRAPHER, "camera"),
        ]
    return Proposal(tuple(subgoals), (*constraints, *keep_clear(task.agents)))


def _tcp(scene: Scene, task: Task, agent: int) -> Matrix:
    return task.arms[agent].tcp(scene.qpos[agent - 1])


def _shutter(scene: Scene, task: Task) -> Matrix:
    """world_from_tcp (4, 4) of the gripper that presses the shutter, z along the press direction."""
    return scene.poses["camera"] @ task.points["camera"]["shutter"]


def _pressed(scene: Scene, task: Task) -> bool:
    """Whether the photographer's fingers are on the shutter and push along its press direction."""
    limits, shutter = task.success, _shutter(scene, task)
    if pushed_n(scene, PHOTOGRAPHER, "camera", shutter[:3, 2]) <= limits["press_n"]:
        return False
    tcp = _tcp(scene, task, PHOTOGRAPHER)
    near = np.linalg.norm(tcp[:3, 3] - shutter[:3, 3]) < limits["press_m"]
    return bool(near and np.degrees(angle_between_rad(tcp[:3, 2], shutter[:3, 2])) < limits["press_deg"])


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Camera and steak are held and aligned, and the shutter is pressed."""
    return {**held_camera.conditions(scene, start, task), "shutter pressed": _pressed(scene, task)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: both high enough, one TCP near the shutter, another near the steak."""
    limits = task.success
    if not held_camera.paper(scene, start, task):
        return False
    shutter = _tcp(scene, task, PHOTOGRAPHER)[:3, 3] - _shutter(scene, task)[:3, 3]
    steak = _tcp(scene, task, held_camera.STEAK_HOLDER)[:3, 3] - scene.poses["steak"][:3, 3]
    near = np.abs(shutter).max() < limits["paper_shutter_m"]
    return bool(near and np.linalg.norm(steak) < limits["paper_steak_m"])
