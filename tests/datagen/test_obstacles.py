"""Obstacles of the planner: the objects of the task, or the voxels occupied in depth pictures."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.datagen.motion.planner import present_state
from rf_exp.datagen.obstacles import Obstacles
from rf_exp.geometry import OBJECT_MARGIN_M, VOXEL_M, PlanningScene, closer_than, voxels
from rf_exp.perception import UNKNOWN_OBSTACLE
from rf_exp.robots import DEFAULT
from rf_exp.statements import Proposal
from rf_exp.transforms import transform
from rf_exp.types import ConstraintSet, Subgoal
from tests.conftest import read_task
from tests.scenes import start_scene

FULL, LOGICAL = ConstraintSet("full"), ConstraintSet("logical", spatial=False, temporal=False)
REST = np.array(DEFAULT.rest_rad)


def obstacle_on(task, scene, points, row=FULL, proposal=None):
    """The obstacle that blocks agent 1 on joint configurations (K, 7); None if free."""
    obstacles = Obstacles(task, scene, row, proposal or Proposal((), ()))
    return obstacles.blocked(avoid_arms=False)(1, points, present_state(task, scene), frozenset())


@pytest.mark.slow
def test_no_arm_starts_too_close_to_an_obstacle(task):
    """Holds for all tasks: planning can start from the initial posture of each arm."""
    for seed in range(20):
        scene = start_scene(task, seed)
        blocked = Obstacles(task, scene, FULL, Proposal((), ())).blocked(avoid_arms=True)
        for agent in task.agents:
            here = scene.qpos[agent - 1, None, :7]
            assert blocked(agent, here, present_state(task, scene), frozenset()) is None


@pytest.mark.slow
def test_the_first_object_that_is_too_near_is_named():
    """Objects are checked in one query; the result is that of checking one after the other."""
    task = read_task("place_food")
    scene, down = start_scene(task, 0), np.diag([1.0, -1.0, -1.0, 1.0])
    planning_scene, rng = PlanningScene(task, scene), np.random.default_rng(2)
    blocked = Obstacles(task, scene, FULL, Proposal((), ())).blocked(avoid_arms=False)
    named = []
    for agent, number in np.ndindex(len(task.agents), len(task.objects)):
        for _ in range(12):
            at = scene.poses[list(task.objects)[number]][:3, 3] + rng.uniform((-0.08, -0.08, 0.0), 0.08)
            joints = task.arms[agent + 1].solve(transform(at) @ down, REST)
            if joints is None:
                continue
            found = blocked(agent + 1, joints[None], present_state(task, scene), frozenset())
            body = planning_scene.arm(agent + 1, joints, touches=())
            each = (
                name
                for name in task.objects
                if closer_than(
                    body, planning_scene.static_objects([name]), OBJECT_MARGIN_M, between=False
                ).any()
            )
            if found not in ("the arm itself", "the table"):
                assert found == next(each, None)
                named.append(found)
    assert set(named) >= {"pot", "steak", None}


def test_a_box_seen_only_by_cameras_is_an_obstacle():
    task = read_task("pass_shoe")
    scene = start_scene(task, 0)
    aside = REST + np.array([0.8, 0, 0, 0, 0, 0, 0])
    path = np.linspace(REST, aside, 12)
    gripper_m = task.arms[1].tcp(aside)[:3, 3]
    low = np.floor(gripper_m / VOXEL_M).astype(int) - 1
    box = low + np.array(list(np.ndindex(3, 3, 3)))
    assert obstacle_on(task, scene, path) is None
    observed = replace(scene, occupied_voxels=box)
    assert obstacle_on(task, observed, path) == UNKNOWN_OBSTACLE
    assert obstacle_on(task, observed, path[:3]) is None
    assert obstacle_on(task, observed, path, LOGICAL) is None  # this row has no spatial constraints
    assert obstacle_on(task, replace(scene, occupied_voxels=box[:0]), path) is None


def test_the_object_of_a_subgoal_is_modelled_by_its_shape_instead_of_its_voxels():
    task = read_task("pick_meat")
    scene = start_scene(task, 0)
    steak = voxels(PlanningScene(task, scene).static_objects(["steak"]))
    observed = replace(scene, occupied_voxels=steak)
    arm = task.arms[1]
    grasp = scene.poses["steak"] @ task.asset("steak").points["center"].object_from_tcp
    joints = arm.solve(transform((0, 0, 0.03)) @ grasp, REST)
    assert joints is not None
    proposal = Proposal((Subgoal(1, "grasp", "steak", "center"),), ())
    assert obstacle_on(task, observed, joints[None], proposal=proposal) is None
    assert obstacle_on(task, observed, joints[None]) == UNKNOWN_OBSTACLE
    off_centre = arm.solve(grasp @ transform((0, 0.03, 0)), joints)  # one finger is inside the steak
    assert off_centre is not None
    assert obstacle_on(task, observed, off_centre[None], proposal=proposal) == "steak"
