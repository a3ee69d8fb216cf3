"""Limits of distance, tilt, height and speed: planned, scheduled and measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.constraints import CheckedPlan, Plan, RoboChecker, limit_speeds
from rf_exp.constraints.checks.speed_limit import speeds_m_s
from rf_exp.coordination import sequential
from rf_exp.geometry import PlanningScene
from rf_exp.statements import Proposal, read
from rf_exp.transforms import transform
from rf_exp.types import ConstraintSet, Scene, Schedule, Segment, Subgoal, Trajectory
from tests.constraints.robots import REACHING, REST, Hand, idle, real, scene_of, walk

FOOD, BAR = real("place_food"), real("lift_barrier")
FULL = ConstraintSet("full")
NEAR = (REST + REACHING) / 2


LIFT = Subgoal(1, "lift", "barrier")


def checked(sentence: str, task, scene: Scene, trajectories) -> tuple[RoboChecker, CheckedPlan]:
    """The checker of one sentence, and its result for its own schedule."""
    goals = tuple(dict.fromkeys(s.subgoal for t in trajectories for s in t.segments))
    checker = RoboChecker(task, Proposal(goals, (read(sentence, task.vocabulary),)), FULL)
    timed = checker.schedule(checker.paths(trajectories, scene))
    assert isinstance(timed, Schedule), timed
    return checker, checker.check(checker.paths(trajectories, scene), timed)


def crossing() -> tuple[Scene, tuple[Trajectory, Trajectory]]:
    """Scene and trajectories in which both arms reach towards the middle and back."""
    return scene_of(BAR), (walk(1, [REST, NEAR, REST], 20), walk(2, [REST, NEAR, REST], 20))


@pytest.mark.parametrize("parts", ["grippers", "arms"])
def test_scheduling_keeps_a_distance(parts) -> None:
    """Without the limit, agents come nearer to each other; with it, they keep the distance and are slower."""
    scene, trajectories = crossing()
    free, together = checked("Agent_1 must finish within 600 s", BAR, scene, trajectories)
    probe = "Agent_1 and Agent_2 must keep their {} at least {} m apart"
    distance, _ = checked(probe.format(parts, 0.0), BAR, scene, trajectories)
    (check,) = (each for each in distance.checks if "apart" in repr(each))
    paths = free.paths(trajectories, scene)
    nearest_m = check.planned(together.plan).value
    in_turn_m = check.planned(Plan(paths, sequential(trajectories, Proposal((), ())))).value
    assert in_turn_m > nearest_m + 1e-3
    limit_m = nearest_m + (in_turn_m - nearest_m) / 20  # the coarse test of arms keeps a larger distance
    limited, limited_plan = checked(probe.format(parts, limit_m), BAR, scene, trajectories)
    assert not limited_plan.violations and len(limited_plan.plan.schedule) > len(together.plan.schedule)
    (violation,) = (
        each for each in limited.check(paths, together.plan.schedule).violations if each.cause == "space"
    )
    assert (
        violation.bound == limit_m
        and violation.value == pytest.approx(nearest_m)
        and "cm apart" in violation.sentence
    )


def test_a_measured_distance_is_monitored() -> None:
    scene, trajectories = crossing()
    checker, watched = checked(
        "Agent_1 and Agent_2 must keep their grippers at least 0.2 m apart", BAR, scene, trajectories
    )
    assert watched.monitor()(scene) is None
    qpos = scene.qpos.copy()
    qpos[:, :7] = NEAR
    arms = PlanningScene(BAR, scene).arms
    distance_m = np.linalg.norm(arms[0].tcp(NEAR)[:3, 3] - arms[1].tcp(NEAR)[:3, 3])
    (check,) = (each for each in checker.checks if "apart" in repr(each))
    evidence = check.measured(replace(scene, qpos=qpos), watched.plan)
    assert evidence is not None and evidence.value == pytest.approx(distance_m)


def carrying(tilt_rad: float) -> tuple[Scene, tuple[Trajectory, Trajectory]]:
    """Scene and trajectories in which agent 1 lifts the steak and then tilts its gripper."""
    scene = scene_of(FOOD)
    builder = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.1)
    turn = transform((0, 0, 0), Rotation.from_rotvec((0, tilt_rad, 0)))
    builder.to(builder.arm.tcp(builder.qpos) @ turn, 10, Subgoal(1, "lift", "steak", height_m=0.1), "lift")
    return scene, (builder.trajectory, idle(2))


@pytest.mark.parametrize(("sentence", "ok"), [
    ("Agent_1 must keep the steak level within 25 deg", True),
    ("Agent_1 must keep the steak level within 15 deg", False),
    ("The steak must be kept upright", False),
])  # fmt: skip
def test_the_tilt_of_a_carried_object_is_limited(sentence, ok) -> None:
    scene, trajectories = carrying(np.deg2rad(20))
    checker, watched = checked(sentence, FOOD, scene, trajectories)
    tilted = [each for each in watched.violations if "tilted" in each.sentence]
    assert (not tilted) is ok
    if tilted:
        assert tilted[0].value == pytest.approx(20, abs=0.5) and tilted[0].agents == (1,)
    (check,) = (each for each in checker.checks if "level" in repr(each))
    overturned = transform(scene.poses["steak"][:3, 3], Rotation.from_rotvec((np.pi, 0, 0)))
    upset_scene = replace(scene, held=("steak", None), poses={**scene.poses, "steak": overturned})
    assert check.measured(scene, watched.plan) is None  # no arm holds it
    evidence = check.measured(upset_scene, watched.plan)
    assert evidence is not None and not evidence.ok and evidence.value == pytest.approx(180)


@pytest.mark.parametrize(("sentence", "ok"), [("below 0.6 m", True), ("below 0.25 m", False),
                                              ("above 0.1 m", True), ("above 0.5 m", False)])  # fmt: skip
def test_a_gripper_stays_below_or_above(sentence, ok) -> None:
    scene, trajectories = scene_of(BAR), (walk(1, [REST, REACHING], 20), idle(2))
    checker, watched = checked(f"Agent_1 must keep its gripper {sentence}", BAR, scene, trajectories)
    assert (not watched.violations) is ok
    qpos = scene.qpos.copy()
    qpos[0, :7] = REACHING
    (check,) = (each for each in checker.checks if "gripper" in repr(each))
    evidence = check.measured(replace(scene, qpos=qpos), watched.plan)
    assert evidence is not None and evidence.value == pytest.approx(0.3, abs=0.05)


def test_a_speed_limit_slows_an_agent_down() -> None:
    """The path is unchanged, and every segment takes as long as the limit requires."""
    scene, trajectories = scene_of(BAR), (walk(1, [REST, REACHING], 20), walk(2, [REST, NEAR], 20))
    checker, watched = checked("Agent_1 must not move faster than 0.1 m/s", BAR, scene, trajectories)
    found = watched.violations
    assert found and found[0].cause == "time" and "m/s" in found[0].sentence
    assert checker.speed_limits_m_s == {1: 0.1}
    arms = PlanningScene(BAR, scene).arms
    slowed = limit_speeds(trajectories, arms, checker.speed_limits_m_s)
    assert slowed[1] is trajectories[1] or slowed[1] == trajectories[1]
    assert len(slowed[0]) > 2 * len(trajectories[0])
    assert 0.08 < speeds_m_s(arms[0], slowed[0].path()).max() <= 0.1
    np.testing.assert_allclose(slowed[0].path()[-1], trajectories[0].path()[-1])
    timed = checker.schedule(checker.paths(slowed, scene))
    assert isinstance(timed, Schedule) and not checker.check(checker.paths(slowed, scene), timed).violations
    (check,) = (each for each in checker.checks if "m/s" in repr(each))
    still, fast = (check.measured(replace(scene, qvel=scene.qvel + v), watched.plan) for v in (0.0, 0.5))
    assert still is not None and still.ok and fast is not None and not fast.ok


def test_a_speed_limit_slows_down_all_arms_of_a_joint_motion() -> None:
    joints = np.linspace(REST, NEAR, 21)[1:]
    both = [
        Trajectory(agent, REST, -1.0, (
            Segment(agent, LIFT, "lift", joints, np.full(20, -1.0), joined="lift"),
        ))
        for agent in (1, 2)
    ]  # fmt: skip
    slowed = limit_speeds(both, PlanningScene(BAR, scene_of(BAR)).arms, {1: 0.03})
    assert len(slowed[0]) == len(slowed[1]) > 40
    assert set(slowed[0].segments[0].gripper) == {-1.0}
    assert limit_speeds(both, PlanningScene(BAR, scene_of(BAR)).arms, {}) == tuple(both)
