"""Arms start free of collisions, however far their initial postures are from rest."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, nearest
from rf_exp.tasks import read_variation
from rf_exp.tasks.task.start import arms_near_objects
from rf_exp.tasks.task.variation import draw
from rf_exp.transforms import planar
from tests.conftest import read_task


def test_an_object_in_collision_with_an_arm_is_named() -> None:
    task = read_task("lift_barrier")
    scene = task.start(0).scene
    assert arms_near_objects(task, scene.qpos, scene.poses) == {}
    x_m, y_m, z_m = task.arms[1].tcp(scene.qpos[0])[:3, 3].tolist()
    assert arms_near_objects(task, scene.qpos, {"barrier": planar(x_m, y_m, 0.0, z_m)}) == {0: "barrier"}
    assert arms_near_objects(task, scene.qpos, {"barrier": planar(x_m, y_m, 0.0, z_m + 0.5)}) == {}


@pytest.mark.slow
def test_postures_in_collision_with_objects_are_reduced() -> None:
    """Checked by exact distances."""
    task = replace(read_task("lift_barrier"), variation=read_variation("full"))
    wide = replace(task, variation=replace(task.variation, posture_rad=0.5))
    reduced = 0
    for each, seed in ((each, seed) for each in (task, wide) for seed in range(12)):
        scene_task = each.in_scene(seed)
        start = scene_task.start(seed)
        scene = PlanningScene(scene_task, start.scene)
        for agent in task.agents:
            gap = nearest(scene.measured(agent, touches=()), scene.static_objects(task.objects))
            assert gap is None or gap.distance_m > 0
        offset_rad = start.qpos[:, : task.dof] - [robot.rest_rad for robot in task.robots]
        reduced += bool(np.abs(offset_rad - draw(scene_task, seed).posture_rad).max() > 0.2)
    assert reduced


@pytest.mark.slow
def test_postures_with_colliding_arms_are_reduced() -> None:
    """Checked by exact distances: in one of ten of these scenes, two arms overlapped by up to 67 mm."""
    task = replace(read_task("three_robots_stack_cube"), variation=read_variation("full"))
    reduced = 0
    for seed in range(1_000_040, 1_000_060):
        scene_task = task.in_scene(seed)
        start = scene_task.start(seed)
        scene = PlanningScene(scene_task, start.scene)
        for a, b in combinations(task.agents, 2):
            assert scene.between(a, b).distance_m > AGENT_MARGIN_M
        drawn_rad = draw(scene_task, seed).posture_rad
        offset_rad = start.qpos[:, : task.dof] - [robot.rest_rad for robot in task.robots]
        # More than four standard deviations of the initial joint noise.
        reduced += bool(np.abs(offset_rad - drawn_rad).max() > 0.08)
    assert reduced >= 4


def test_arms_that_collide_even_at_rest_are_retracted() -> None:
    """A higher table moves the camera into the arm that waits over it."""
    task = replace(read_task("take_photo"), variation=read_variation("full"))
    for seed in (16, 19, 53):
        scene_task = task.in_scene(seed)
        start = scene_task.start(seed)
        assert arms_near_objects(scene_task, start.qpos, start.poses) == {}
        at_rest = start.qpos.copy()
        at_rest[3, :7] = task.robots[3].rest_rad
        assert arms_near_objects(scene_task, at_rest, start.poses) == {3: "camera"}
