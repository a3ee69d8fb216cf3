"""The verb `press`: from above with closed fingers, and a little farther where no contact was measured."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rf_exp.constraints.checks.interaction import POSITION_M, ContactAtCheck
from rf_exp.datagen import make_episode
from rf_exp.datagen.motion.verbs import EXTRA_PRESS_M
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.transforms import inverse, transform
from rf_exp.types import GRIPPER_CLOSED, Scene, Subgoal, Trajectory
from tests.conftest import cell_of, experiment, read_task
from tests.datagen.test_motion import plan
from tests.scenes import start_scene

PRESS = Subgoal(4, "press", "camera", "shutter")


@pytest.fixture(scope="module")
def task() -> Task:
    return read_task("take_photo")


def press_trajectory(task: Task, scene: Scene) -> Trajectory:
    return plan(task, Proposal((PRESS,), ()), scene)[0][3]


def at_end(scene: Scene, trajectory: Trajectory) -> Scene:
    qpos = scene.qpos.copy()
    qpos[3, :7] = trajectory.segments[-1].qpos[-1]
    return replace(scene, qpos=qpos)


def test_a_press_without_contact_is_repeated_farther(task: Task) -> None:
    scene = start_scene(task, 0)
    trajectory = press_trajectory(task, scene)
    assert [each.primitive for each in trajectory.segments] == ["close", "press"]
    for _ in range(2):
        scene = at_end(scene, trajectory)
        again = press_trajectory(task, scene)
        (segment,) = again.segments
        assert segment.primitive == "press" and (segment.gripper == GRIPPER_CLOSED).all()
        assert segment.touches == {"camera"}
        before, after = (task.arms[4].tcp(points) for points in (scene.qpos[3, :7], segment.qpos[-1]))
        moved = inverse(before) @ after
        np.testing.assert_allclose(moved[:3, 3], [0, 0, EXTRA_PRESS_M], atol=1e-5)
        np.testing.assert_allclose(moved[:3, :3], np.eye(3), atol=1e-5)
        trajectory = again


def test_a_press_from_elsewhere_begins_above_the_point(task: Task) -> None:
    scene = start_scene(task, 0)
    after_press = at_end(scene, press_trajectory(task, scene))
    beside = np.array([0.0, 0.01, 0.0, -0.01, 0.0, 0.0, 0.0])
    qpos = after_press.qpos.copy()
    qpos[3, :7] -= 3 * beside
    segments = press_trajectory(task, replace(after_press, qpos=qpos)).segments
    assert [each.primitive for each in segments] == ["close", "press"]


@pytest.mark.slow
def test_joint_measurement_errors_do_not_prevent_pressing() -> None:
    """In this scene the measured joints put the finger 4 mm into the camera, while it is really above it."""
    config = experiment("task=take_photo", "variation=encoders", "render=false", "stages=[generate]")
    cell = cell_of(config)
    outcome = make_episode(config.settings(cell.task, cell.constraint_set), config.pictures, 2, ())
    assert outcome.success, outcome.reason


def test_distance_along_the_pressing_direction_is_tolerated(task: Task) -> None:
    """A TCP up to 2 cm farther along the pressing direction is accepted; 1 cm across it is not."""
    check = ContactAtCheck(4, "camera", "shutter")
    scene = start_scene(task, 0)
    pressed = scene.poses["camera"] @ task.points["camera"]["shutter"]
    plan: Any = SimpleNamespace(task=task)
    for moved_m, beside_m in (
        ((0, 0, 0), 0),
        ((0, 0, 0.012), 0),
        ((0, 0, 0.025), 0.005),
        ((0, 0, -0.012), 0.012),
        ((0.011, 0, 0.012), 0.011),
    ):
        found = check._position_evidence(plan, pressed @ transform(moved_m), scene.poses["camera"], 0.0)
        assert found.value == pytest.approx(beside_m, abs=1e-9) and found.ok == (beside_m <= POSITION_M)
