"""Arms with held objects: poses of objects before, while and after they are held, and allowed contacts."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.errors import ArgumentError
from rf_exp.geometry import PlanningScene, closer_than, lowest_m, nearest
from rf_exp.robots import DEFAULT
from rf_exp.transforms import transform
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Segment, Subgoal, Trajectory
from tests.constraints.robots import REST, Hand, idle, motion, real, scene_of, team, walk

FOOD = real("place_food")


@pytest.fixture(scope="module")
def lid_plan():
    """Agent 2 takes the lid off the pot and lifts it."""
    scene = scene_of(FOOD)
    hand = Hand(FOOD, scene, 2).grasp("lid", "knob").lift(0.12)
    trajectories = (idle(1, scene.qpos[0, :7]), hand.trajectory)
    return scene, trajectories, PlanningScene(FOOD, scene, trajectories)


def test_an_object_rests_and_then_moves_with_the_gripper(lid_plan):
    scene, trajectories, planning_scene = lid_plan
    body = planning_scene.along(trajectories[1])
    lid = body.labels.index("lid")
    carry = trajectories[1].knots[-2]
    assert np.allclose(body.poses[: carry + 1, lid], scene.poses["lid"], atol=1e-3)
    assert body.poses[-1, lid, 2, 3] == pytest.approx(scene.poses["lid"][2, 3] + 0.12, abs=2e-3)
    assert (np.flatnonzero(body.carried["lid"]) == np.arange(carry, len(body))).all()
    assert "lid" not in planning_scene.static_objects().labels


def test_the_gripper_may_touch_only_objects_of_its_segment(lid_plan):
    scene, trajectories, planning_scene = lid_plan
    body = planning_scene.along(trajectories[1])
    assert not closer_than(body, planning_scene.static_objects(), 0.003).any()
    without_contacts = replace(
        trajectories[1],
        segments=tuple(replace(s, touches=frozenset(), attached=None) for s in trajectories[1].segments),
    )
    strict_scene = PlanningScene(FOOD, scene, (trajectories[0], without_contacts))
    closest = nearest(strict_scene.along(without_contacts), strict_scene.static_objects(["lid"]))
    assert closest is not None and closest.distance_m < 0.003
    assert "finger" in closest.a and closest.b == "lid"


def test_a_lid_may_touch_its_pot_only_while_it_is_lifted_off(lid_plan):
    _, trajectories, planning_scene = lid_plan
    body = planning_scene.along(trajectories[1])
    assert body.rests["pot"][trajectories[1].knots[-2] :].all()
    assert not body.rests["pot"][: trajectories[1].knots[-2]].any()
    assert not body.rests["steak"].any()


def test_an_object_held_by_one_arm_is_an_obstacle_for_another(lid_plan):
    scene, trajectories, _ = lid_plan
    over_pot = Hand(FOOD, scene, 1)
    above = transform((*scene.poses["pot"][:2, 3], 0.30)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    other = over_pot.to(above, 20, Subgoal(1, "carry", "steak"), "move").trajectory
    both = PlanningScene(FOOD, scene, (other, trajectories[1]))
    diagram = closer_than(both.along(other), both.along(trajectories[1]), 0.01)
    assert not diagram[0].any()  # at rest, agent 1 blocks no cell
    assert diagram[-1, -1]  # over the pot it meets the arm that lifts the lid


def test_a_held_object_may_be_touched_until_the_gripper_has_opened():
    task = real("lift_barrier")
    scene = scene_of(task)
    grasped = Hand(task, scene, 1).grasp("barrier", "left")
    qpos = scene.qpos.copy()
    qpos[0, :7], qpos[0, 7:] = grasped.qpos, 0.013
    held = replace(scene, qpos=qpos, held=("barrier", None))
    subgoal = Subgoal(1, "release", "barrier")
    opening = Segment(1, subgoal, "open", np.tile(grasped.qpos, (8, 1)), np.full(8, GRIPPER_OPEN))
    retreat = Segment(1, subgoal, "retreat", motion(grasped.qpos, REST, 20), np.full(20, GRIPPER_OPEN))
    trajectory = Trajectory(1, grasped.qpos, GRIPPER_CLOSED, (opening, retreat))
    body = PlanningScene(task, held, (trajectory, idle(2))).along(trajectory)
    assert body.touches["barrier"].tolist() == [True] * 9 + [False] * 20


def test_fingers_are_assumed_as_wide_as_possible():
    scene = scene_of(FOOD)
    hand = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.1)
    planning_scene = PlanningScene(FOOD, scene, (hand.trajectory, idle(2)))
    body = planning_scene.along(hand.trajectory)
    left, right = (body.labels.index(f"panda_{side}finger") for side in ("left", "right"))
    width = np.linalg.norm(body.poses[:, left, :3, 3] - body.poses[:, right, :3, 3], axis=1)
    assert width[: hand.trajectory.knots[2] + 1] == pytest.approx(2 * DEFAULT.hand.open_m)
    assert width[-1] == pytest.approx(FOOD.asset("steak").points["center"].width_m)


def test_an_object_held_by_two_arms_is_not_an_obstacle_between_them():
    """One end of the barrier is lifted first: the wrist of the other arm is not an obstacle."""
    task = real("lift_barrier")
    start = scene_of(task)
    qpos = start.qpos.copy()
    for agent, point in ((1, "left"), (2, "right")):
        qpos[agent - 1, :7] = Hand(task, start, agent).grasp("barrier", point).qpos
    held = replace(start, qpos=qpos, held=("barrier", "barrier"))
    for scene, blocked in ((held, False), (replace(held, held=("barrier", None)), True)):
        lift = Hand(task, scene, 1).hold("barrier").lift(0.17).trajectory
        planning_scene = PlanningScene(task, scene, (lift, idle(2, qpos[1, :7])))
        other = planning_scene.arm(2, scene.qpos[1])
        assert closer_than(planning_scene.along(lift), other, 0.01).any() == blocked


def test_all_links_but_the_base_are_checked_against_the_table():
    task = team(1)
    planning_scene = PlanningScene(task, scene_of(task))
    low = REST.copy()
    low[1] = 1.6
    assert planning_scene.below_table(planning_scene.arm(1, np.stack([REST, low]))).tolist() == [False, True]
    assert lowest_m(planning_scene.arm(1, REST))[0] > 0.02


def test_the_distance_of_two_arms_names_their_links():
    closest = PlanningScene(FOOD, scene_of(FOOD)).between(1, 2)
    assert 0.0 < closest.distance_m < 1.0
    assert closest.a.startswith("panda_") and closest.b.startswith("panda_")


def test_an_unknown_object_is_refused_with_the_known_ones():
    scene = scene_of(FOOD)
    stray = walk(1, [REST, REST + 0.1], attached="hat", tcp_from_object=np.eye(4))
    with pytest.raises(ArgumentError, match=r"unknown attached object 'hat'; available: lid, pot, steak"):
        PlanningScene(FOOD, scene, (stray, idle(2)))
    with pytest.raises(ArgumentError, match=r"unknown object 'hat'; available: lid, pot, steak"):
        PlanningScene(FOOD, scene).static_objects(["hat"])


def test_holding_an_object_without_a_grasp_pose_is_refused():
    scene = scene_of(FOOD)
    loose = walk(1, [REST, REST + 0.1], attached="steak")
    with pytest.raises(
        ArgumentError, match=r"agent 1, segment 'move' has 'steak' attached, but tcp_from_object is missing"
    ):
        PlanningScene(FOOD, scene, (loose, idle(2))).along(loose)
    with pytest.raises(ArgumentError, match=r"agent 1 has 'steak' attached, but tcp_from_object is missing"):
        PlanningScene(FOOD, scene).arm(1, REST, attached="steak")
