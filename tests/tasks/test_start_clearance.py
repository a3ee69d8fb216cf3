"""Arms stand in nothing when an episode begins, however far from rest their postures are."""

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


def test_what_an_arm_stands_in_is_named() -> None:
    task = read_task("lift_barrier")
    scene = task.start(0).scene
    assert arms_near_objects(task, scene.qpos, scene.poses) == {}
    x_m, y_m, z_m = task.arms[1].tcp(scene.qpos[0])[:3, 3].tolist()
    assert arms_near_objects(task, scene.qpos, {"barrier": planar(x_m, y_m, 0.0, z_m)}) == {0: "barrier"}
    assert arms_near_objects(task, scene.qpos, {"barrier": planar(x_m, y_m, 0.0, z_m + 0.5)}) == {}


@pytest.mark.slow
def test_postures_that_would_stand_in_a_thing_are_taken_back() -> None:
    """As exact distances say."""
    task = replace(read_task("lift_barrier"), variation=read_variation("full"))
    wide = replace(task, variation=replace(task.variation, posture_rad=0.5))
    taken_back = 0
    for each, seed in ((each, seed) for each in (task, wide) for seed in range(12)):
        scene_task = each.in_scene(seed)
        start = scene_task.start(seed)
        scene = PlanningScene(scene_task, start.scene)
        for agent in task.agents:
            apart = nearest(scene.measured(agent, touches=()), scene.static_objects(task.objects))
            assert apart is None or apart.distance_m > 0
        by_rad = start.qpos[:, : task.dof] - [robot.rest_rad for robot in task.robots]
        taken_back += bool(np.abs(by_rad - draw(scene_task, seed).posture_rad).max() > 0.2)
    assert taken_back


@pytest.mark.slow
def test_postures_in_which_arms_would_meet_are_taken_back() -> None:
    """As exact distances say: of these scenes, in one of ten two arms stood up to 67 mm in one another."""
    task = replace(read_task("three_robots_stack_cube"), variation=read_variation("full"))
    taken_back = 0
    for seed in range(1_000_040, 1_000_060):
        stands = task.in_scene(seed)
        start = stands.start(seed)
        scene = PlanningScene(stands, start.scene)
        for a, b in combinations(task.agents, 2):
            assert scene.between(a, b).distance_m > AGENT_MARGIN_M
        drawn_rad = draw(stands, seed).posture_rad
        by_rad = start.qpos[:, : task.dof] - [robot.rest_rad for robot in task.robots]
        taken_back += bool(np.abs(by_rad - drawn_rad).max() > 0.08)  # four deviations of every start
    assert taken_back >= 4


def test_who_stands_in_a_thing_at_rest_as_well_is_drawn_in() -> None:
    """A higher table brings the camera to the arm that waits over it."""
    task = replace(read_task("take_photo"), variation=read_variation("full"))
    for seed in (16, 19, 53):
        stands = task.in_scene(seed)
        start = stands.start(seed)
        assert arms_near_objects(stands, start.qpos, start.poses) == {}
        at_rest = start.qpos.copy()
        at_rest[3, :7] = task.robots[3].rest_rad
        assert arms_near_objects(stands, at_rest, start.poses) == {3: "camera"}
