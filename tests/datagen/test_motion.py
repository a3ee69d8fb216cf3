"""Properties of planned motion for every task, and the reasons reported where planning fails."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.datagen import Unreachable
from rf_exp.datagen.motion import request
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.planner import plan_motion
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.verbs import GRIPPER_STEPS
from rf_exp.datagen.obstacles import Obstacles
from rf_exp.datagen.yielding import Yielding, planning_modes
from rf_exp.geometry import PlanningScene, nearest
from rf_exp.robots import DEFAULT, Arm
from rf_exp.statements import Proposal
from rf_exp.tasks import default_of, named_task
from rf_exp.transforms import equal_rotations, planar
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, ConstraintSet, JointLimits, Subgoal
from tests.conftest import read_task
from tests.scenes import start_scene

LIMITS = JointLimits(**default_of("limits"))


def plan(task, proposal, scene, *, row=None, avoid_arms=False, lockstep=(), yielding=None):
    blocked = Obstacles(task, scene, row or ConstraintSet("full"), proposal).blocked(avoid_arms=avoid_arms)
    reach = Reach(task.arms, LIMITS, blocked, Search(np.random.default_rng(0)))
    motion = plan_motion(task, proposal, scene, reach, lockstep=lockstep, yielding=yielding or Yielding())
    return motion.trajectories, motion.state


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_planned_motion_is_continuous_and_keeps_the_limits(task, seed):
    scene = start_scene(task, seed)
    trajectories, _ = plan(task, task.module.plan(scene, task), scene)
    low, high = DEFAULT.limits_rad
    assert [trajectory.agent for trajectory in trajectories] == list(task.agents)
    for trajectory in filter(len, trajectories):
        joints = trajectory.path()[:, :7]
        np.testing.assert_array_equal(joints[0], scene.qpos[trajectory.agent - 1, :7])
        velocity = np.diff(joints, axis=0) * 20
        padded = np.concatenate([np.zeros((1, 7)), velocity, np.zeros((1, 7))])
        assert np.abs(velocity).max() <= LIMITS.velocity_rad_s * 1.01
        assert np.abs(np.diff(padded, axis=0)).max() * 20 <= LIMITS.acceleration_rad_s2 * 1.01
        assert (joints > low).all() and (joints < high).all()
        for knot in trajectory.knots[1:-1]:  # at rest: the next sample is at most as far as
            step = LIMITS.acceleration_rad_s2 / 20**2  # the acceleration allows from rest
            assert np.abs(joints[knot + 1] - joints[knot]).max() <= step * 1.1


def test_an_idle_agent_yields_first_unless_it_holds_an_object(place_food):
    scene = start_scene(place_food, 0)
    proposal = Proposal((Subgoal(1, "grasp", "steak", "center"),), ())
    for held, length in ((None, 1), ("lid", 0)):
        holding = replace(scene, held=(None, held))
        last = planning_modes(proposal, holding, ConstraintSet("full"))[-1]
        trajectories, _ = plan(place_food, proposal, holding, yielding=last.yielding)
        segments = trajectories[1].segments
        assert [(each.subgoal.verb, each.primitive) for each in segments] == [("aside", "move")] * length
        for segment in segments:
            np.testing.assert_allclose(segment.qpos[-1], DEFAULT.aside_rad, atol=1e-9)
    assert not plan(place_food, proposal, scene)[0][1].segments


@pytest.mark.slow
def test_same_seed_same_motion(task):
    scene = start_scene(task, 5)
    first, second = (plan(task, task.module.plan(scene, task), scene)[0] for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.path(), b.path())


def test_a_grasp_ends_at_the_annotated_point_with_fingers_closed(lift_barrier):
    scene = start_scene(lift_barrier, 0)
    trajectories, state = plan(lift_barrier, Proposal((Subgoal(1, "grasp", "barrier", "left"),), ()), scene)
    approach, close = trajectories[0].segments
    assert (approach.primitive, close.primitive) == ("approach", "close")
    assert len(close) == GRIPPER_STEPS and (close.gripper == GRIPPER_CLOSED).all()
    assert (approach.gripper == GRIPPER_OPEN).all() and approach.touches == {"barrier"}
    tcp = Arm(DEFAULT, lift_barrier.robots[0].world_from_base).tcp(approach.qpos[-1])
    expected = scene.poses["barrier"] @ lift_barrier.asset("barrier").points["left"].object_from_tcp
    np.testing.assert_allclose(tcp[:3, 3], expected[:3, 3], atol=5e-4)
    assert abs(tcp[:3, 1] @ expected[:3, 1]) > 0.9999  # in either orientation: the fingers are symmetric
    assert state.held[1][0] == "barrier"
    assert len(trajectories[1]) == 0


def test_a_joint_lift_keeps_both_grippers_level(lift_barrier):
    scene = start_scene(lift_barrier, 1)
    grasps = Proposal(tuple(Subgoal(k, "grasp", "barrier", p) for k, p in ((1, "left"), (2, "right"))), ())
    lifts = tuple(Subgoal(k, "lift", "barrier", height_m=0.17) for k in (1, 2))
    both = (frozenset({1, 2}), "lift", "barrier")
    trajectories, _ = plan(lift_barrier, Proposal(grasps.subgoals + lifts, ()), scene, lockstep=[both])
    segments = [trajectory.segments[-1] for trajectory in trajectories]
    assert {segment.joined for segment in segments} == {"lift barrier"}
    heights = [
        Arm(DEFAULT, robot.world_from_base).tcp(segment.qpos)[:, 2, 3]
        for robot, segment in zip(lift_barrier.robots, segments, strict=True)
    ]
    assert len(heights[0]) == len(heights[1])
    np.testing.assert_allclose(heights[0], heights[1], atol=1.5e-3)
    np.testing.assert_allclose(heights[0][-1] - 0.074, 0.17, atol=2e-3)


def test_placed_objects_end_at_their_goals(place_food):
    scene = start_scene(place_food, 0)
    _, state = plan(place_food, place_food.module.plan(scene, place_food), scene)
    goal = place_food.places(scene)["aside"]
    np.testing.assert_allclose(state.poses["lid"][:2, 3], goal[:2, 3], atol=1e-3)
    assert np.linalg.norm(state.poses["steak"][:2, 3] - scene.poses["pot"][:2, 3]) < 0.035
    assert state.held == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("subgoals", "message"),
    [
        ((Subgoal(1, "lift", "steak", height_m=0.1),), "does not hold steak"),
        ((Subgoal(1, "grasp", "steak", "center"), Subgoal(1, "grasp", "lid", "knob")), "already holds steak"),
        ((Subgoal(2, "grasp", "steak", "center"),), "Agent_2 cannot grasp steak at center"),
        (
            (Subgoal(1, "grasp", "steak", "center"), Subgoal(1, "place", "steak", target="moon")),
            "no place or object 'moon'; available: aside, lid, pot, steak",
        ),
        (
            (Subgoal(1, "grasp", "steak", "center"), Subgoal(1, "place", "steak", target="lid")),
            "lid has no place point: nothing can be put there",
        ),
        (
            (Subgoal(2, "grasp", "lid", "knob"), Subgoal(2, "lift", "lid", height_m=2.0)),
            "does not reach that high",
        ),
    ],
)
def test_unreachable_subgoals_are_explained(place_food, subgoals, message):
    with pytest.raises(Unreachable, match=message):
        plan(place_food, Proposal(subgoals, ()), start_scene(place_food, 0))


def test_only_a_planner_with_spatial_constraints_avoids_a_parked_arm(place_food):
    scene = start_scene(place_food, 0)
    # The other arm is parked with its fingers above the knob that agent 1 has to grasp.
    other = Arm(DEFAULT, place_food.robots[1].world_from_base)
    above = scene.poses["lid"] @ place_food.asset("lid").points["knob"].object_from_tcp
    above[2, 3] += 0.06
    parked = other.solve(above, np.array(DEFAULT.rest_rad))
    assert parked is not None
    qpos = scene.qpos.copy()
    qpos[1, :7] = parked
    scene = replace(scene, qpos=qpos)
    grasp = Proposal((Subgoal(1, "grasp", "lid", "knob"),), ())
    plan(
        place_food, grasp, scene, row=ConstraintSet("logical", spatial=False, temporal=False), avoid_arms=True
    )
    with pytest.raises(Unreachable, match="Agent_1 cannot grasp lid at knob"):
        plan(place_food, grasp, scene, avoid_arms=True)


def test_rrt_goes_round_a_wall():
    def free(points):  # a wall at joint 1 = 0.5 rad with a gap in joint 2
        return not ((np.abs(points[:, 0] - 0.5) < 0.1) & (points[:, 1] < 0.8)).any()

    start, goal = np.zeros(7), np.eye(7)[0]
    path = Search(np.random.default_rng(0)).path(start, goal, free, DEFAULT.limits_rad)
    assert path is not None and len(path) > 2
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_array_equal(path[-1], goal)


def test_a_failed_search_ends_and_straight_lines_still_work() -> None:
    tried = 0

    def free(points):
        nonlocal tried
        tried += 1
        return not (np.abs(points[:, 0] - 0.5) < 0.1).any()

    start, goal = np.zeros(7), np.eye(7)[0]
    search = Search(np.random.default_rng(0), edges=50)
    for _ in range(3):
        assert search.path(start, goal, free, DEFAULT.limits_rad) is None
    assert tried < 70  # each search checks the line and both ends; a started branch is completed
    assert search.path(start, np.eye(7)[1], free, DEFAULT.limits_rad) is not None


def test_arms_turned_to_the_table_reach_it():
    assert Arm(DEFAULT, planar(0.0, -0.75, np.pi / 2)).tcp(np.array(DEFAULT.rest_rad))[1, 3] > -0.2


def test_a_round_object_is_grasped_from_the_fastest_side():
    """Also where it is turned about its own axis of symmetry."""
    task = read_task("place_cube_in_cup")
    scene = start_scene(task, 1)
    subgoals = tuple(each for each in task.module.plan(scene, task).subgoals if each.agent == 1)
    found = []
    for turn in (0, 5):
        cup = scene.poses["cup"] @ equal_rotations(12)[turn]
        trajectories, _ = plan(
            task, Proposal(subgoals, ()), replace(scene, poses={**scene.poses, "cup": cup})
        )
        found.append(trajectories[0])
    tcp_poses = [task.arms[1].tcp(each.segments[0].qpos[-1]) for each in found]
    np.testing.assert_allclose(tcp_poses[0], tcp_poses[1], atol=1e-6)
    approach = tcp_poses[0][:3, :3] @ (0.0, 0.0, 1.0)
    # Not from behind the cup.
    assert approach @ (scene.poses["cup"][:3, 3] - task.arms[1].world_from_base[:3, 3]) > 0
    assert abs(len(found[0]) - len(found[1])) <= 1


@pytest.mark.slow
def test_a_grasp_is_chosen_so_that_the_arm_can_rise_with_the_object(monkeypatch):
    ring = named_task("ring_1x3")
    assert ring is not None
    scene = start_scene(ring, 15)  # a finger of the fastest grasp is too near to the next cube
    proposal = ring.module.plan(scene, ring)
    plan(ring, proposal, scene)
    monkeypatch.setattr(request, "_can_rise", lambda *_: True)
    with pytest.raises(Unreachable, match=r"cube1_1 to goal1_1 .* cube1_2 is in the way"):
        plan(ring, proposal, scene)


@pytest.mark.slow
def test_a_rounded_detour_keeps_clear_of_its_obstacle():
    """The path to the stem leads round the bowl; with seed 0 its corners once cut through the bowl."""
    task = read_task("place_cube_in_cup")
    scene = start_scene(task, 0)
    trajectories, _ = plan(task, task.module.plan(scene, task), scene)
    planning_scene = PlanningScene(task, scene)
    cup = replace(planning_scene.static_objects(["cup"]), objects=frozenset())
    approach = trajectories[0].segments[0].qpos
    gap = nearest(planning_scene.arm(1, approach), cup)
    assert gap is not None and gap.distance_m > 0
