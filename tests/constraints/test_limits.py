"""Limits: distance, tilt, height and speed, planned, scheduled and measured."""

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
    """The checker of one sentence, and what it finds in its own schedule."""
    goals = tuple(dict.fromkeys(s.subgoal for t in trajectories for s in t.segments))
    checker = RoboChecker(task, Proposal(goals, (read(sentence, task.vocabulary),)), FULL)
    timed = checker.schedule(checker.paths(trajectories, scene))
    assert isinstance(timed, Schedule), timed
    return checker, checker.check(checker.paths(trajectories, scene), timed)


def crossing() -> tuple[Scene, tuple[Trajectory, Trajectory]]:
    """Both arms reach towards the middle, one after the other, and back."""
    return scene_of(BAR), (walk(1, [REST, NEAR, REST], 20), walk(2, [REST, NEAR, REST], 20))


@pytest.mark.parametrize("parts", ["grippers", "arms"])
def test_timing_keeps_a_distance(parts) -> None:
    """A schedule without the limit comes nearer; with it, agents keep away from each other, later."""
    scene, trajectories = crossing()
    free, together = checked("Agent_1 must finish within 600 s", BAR, scene, trajectories)
    probe = "Agent_1 and Agent_2 must keep their {} at least {} m apart"
    distance, _ = checked(probe.format(parts, 0.0), BAR, scene, trajectories)
    (check,) = (each for each in distance.checks if "apart" in repr(each))
    paths = free.paths(trajectories, scene)
    nearest_m = check.planned(together.plan).value
    in_turn_m = check.planned(Plan(paths, sequential(trajectories, Proposal((), ())))).value
    assert in_turn_m > nearest_m + 1e-3
    asked_m = nearest_m + (in_turn_m - nearest_m) / 20  # the first look at arms keeps more than is asked
    asking, kept = checked(probe.format(parts, asked_m), BAR, scene, trajectories)
    assert not kept.violations and len(kept.plan.schedule) > len(together.plan.schedule)
    (late,) = (
        each for each in asking.check(paths, together.plan.schedule).violations if each.cause == "space"
    )
    assert late.bound == asked_m and late.value == pytest.approx(nearest_m) and "cm apart" in late.sentence


def test_a_measured_distance_is_watched() -> None:
    scene, trajectories = crossing()
    checker, watched = checked(
        "Agent_1 and Agent_2 must keep their grippers at least 0.2 m apart", BAR, scene, trajectories
    )
    assert watched.monitor()(scene) is None
    qpos = scene.qpos.copy()
    qpos[:, :7] = NEAR
    arms = PlanningScene(BAR, scene).arms
    apart_m = np.linalg.norm(arms[0].tcp(NEAR)[:3, 3] - arms[1].tcp(NEAR)[:3, 3])
    (check,) = (each for each in checker.checks if "apart" in repr(each))
    evidence = check.measured(replace(scene, qpos=qpos), watched.plan)
    assert evidence is not None and evidence.value == pytest.approx(apart_m)


def carrying(tilt_rad: float) -> tuple[Scene, tuple[Trajectory, Trajectory]]:
    """Agent 1 lifts the steak and turns its hand meanwhile."""
    scene = scene_of(FOOD)
    hand = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.1)
    turn = transform((0, 0, 0), Rotation.from_rotvec((0, tilt_rad, 0)))
    hand.to(hand.arm.tcp(hand.qpos) @ turn, 10, Subgoal(1, "lift", "steak", height_m=0.1), "lift")
    return scene, (hand.trajectory, idle(2))


@pytest.mark.parametrize(("sentence", "ok"), [
    ("Agent_1 must keep the steak level within 25 deg", True),
    ("Agent_1 must keep the steak level within 15 deg", False),
    ("The steak must be kept upright", False),
])  # fmt: skip
def test_what_is_carried_is_tilted_or_not(sentence, ok) -> None:
    scene, trajectories = carrying(np.deg2rad(20))
    checker, watched = checked(sentence, FOOD, scene, trajectories)
    tilted = [each for each in watched.violations if "tilted" in each.sentence]
    assert (not tilted) is ok
    if tilted:
        assert tilted[0].value == pytest.approx(20, abs=0.5) and tilted[0].agents == (1,)
    (check,) = (each for each in checker.checks if "level" in repr(each))
    lying = transform(scene.poses["steak"][:3, 3], Rotation.from_rotvec((np.pi, 0, 0)))
    upset = replace(scene, held=("steak", None), poses={**scene.poses, "steak": lying})
    assert check.measured(scene, watched.plan) is None  # nobody holds it
    evidence = check.measured(upset, watched.plan)
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


def test_a_slow_agent_takes_its_time() -> None:
    """The path stays, and every segment takes as long as the limit asks."""
    scene, trajectories = scene_of(BAR), (walk(1, [REST, REACHING], 20), walk(2, [REST, NEAR], 20))
    checker, watched = checked("Agent_1 must not move faster than 0.1 m/s", BAR, scene, trajectories)
    found = watched.violations
    assert found and found[0].cause == "time" and "m/s" in found[0].sentence
    assert checker.speed_limits_m_s == {1: 0.1}
    arms = PlanningScene(BAR, scene).arms
    slow = limit_speeds(trajectories, arms, checker.speed_limits_m_s)
    assert slow[1] is trajectories[1] or slow[1] == trajectories[1]
    assert len(slow[0]) > 2 * len(trajectories[0])
    assert 0.08 < speeds_m_s(arms[0], slow[0].path()).max() <= 0.1
    np.testing.assert_allclose(slow[0].path()[-1], trajectories[0].path()[-1])
    timed = checker.schedule(checker.paths(slow, scene))
    assert isinstance(timed, Schedule) and not checker.check(checker.paths(slow, scene), timed).violations
    (check,) = (each for each in checker.checks if "m/s" in repr(each))
    still, fast = (check.measured(replace(scene, qvel=scene.qvel + v), watched.plan) for v in (0.0, 0.5))
    assert still is not None and still.ok and fast is not None and not fast.ok


def test_a_joint_motion_is_slow_together() -> None:
    joints = np.linspace(REST, NEAR, 21)[1:]
    both = [
        Trajectory(agent, REST, -1.0, (
            Segment(agent, LIFT, "lift", joints, np.full(20, -1.0), joined="lift"),
        ))
        for agent in (1, 2)
    ]  # fmt: skip
    slow = limit_speeds(both, PlanningScene(BAR, scene_of(BAR)).arms, {1: 0.03})
    assert len(slow[0]) == len(slow[1]) > 40
    assert set(slow[0].segments[0].gripper) == {-1.0}
    assert limit_speeds(both, PlanningScene(BAR, scene_of(BAR)).arms, {}) == tuple(both)
