"""Spatial checks of other agents, objects and zones, planned and measured."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import AvoidAgentsCheck, Paths, Plan, PolicyMonitor, contact_evidence
from rf_exp.constraints.checks.avoidance import AvoidObjectsCheck
from rf_exp.constraints.checks.keep_out import KeepOutCheck
from rf_exp.constraints.checks.share_space import ShareSpaceCheck
from rf_exp.coordination import schedule
from rf_exp.geometry import PlanningScene, Separation, nearest
from rf_exp.transforms import inverse, transform
from rf_exp.types import CONTROL_DT_S, ConstraintSet, Schedule, Subgoal
from tests.constraints.robots import REACHING, REST, Hand, idle, real, scene_of, team, walk

BAR, FOOD = real("lift_barrier"), real("place_food")
FULL = ConstraintSet("full")


def simultaneous(trajectories) -> Schedule:
    """Schedule of all trajectories at once, without regard to collisions."""
    timed = schedule(trajectories)
    assert isinstance(timed, Schedule)
    return timed


def plan_of(task, scene, trajectories, timed=None) -> Plan:
    return Plan(Paths(task, FULL, scene, trajectories), timed or simultaneous(trajectories))


@pytest.fixture(scope="module")
def crossing() -> Plan:
    """Plan in which both arms reach over the middle at the same time."""
    scene = scene_of(BAR)
    return plan_of(BAR, scene, (walk(1, [REST, REACHING], 20), walk(2, [REST, REACHING], 20)))


def test_arms_that_meet_are_named_with_time_and_links(crossing):
    evidence = AvoidAgentsCheck((1,)).planned(crossing)
    assert not evidence.ok and evidence.value < 0.05 and 0 < evidence.time_s < 1.0
    near = f"comes within {evidence.value * 100:.1f} cm of Agent_2, to carry thing0 (move) (panda_"
    assert evidence.sentence.startswith(f"at {evidence.time_s:.2f} s Agent_1, to carry thing0 (move), {near}")


def test_a_clear_schedule_reports_its_least_distance(crossing):
    there_and_back = tuple(walk(agent, [REST, REACHING, REST], 20) for agent in (1, 2))
    paths = Paths(BAR, FULL, crossing.scene, there_and_back)
    timed = schedule(there_and_back, paths.diagrams)
    assert isinstance(timed, Schedule)
    assert 40 < len(timed) < 80  # overlapping in time, but without collision
    evidence = AvoidAgentsCheck((1, 2)).planned(plan_of(BAR, crossing.scene, there_and_back, timed))
    assert evidence.ok and evidence.value >= evidence.bound
    bodies = [paths.planning_scene.along(trajectory) for trajectory in there_and_back]
    least = nearest(*bodies, at=timed.positions)
    assert least is not None and least.distance_m == pytest.approx(evidence.value)


def test_shared_space_reports_the_least_time_between_its_uses(crossing):
    there_and_back = tuple(walk(agent, [REST, REACHING, REST], 20) for agent in (1, 2))
    paths = Paths(BAR, FULL, crossing.scene, there_and_back)
    timed = schedule(there_and_back, paths.diagrams)
    assert isinstance(timed, Schedule)
    assert ShareSpaceCheck((2, 1)).rule(paths) is None  # it demands nothing of a schedule by itself
    evidence = ShareSpaceCheck((2, 1)).planned(Plan(paths, timed))
    first, then = evidence.agents
    first_positions, then_positions = timed.positions[:, first - 1], timed.positions[:, then - 1]
    too_close = paths.diagrams[1, 2] if first == 1 else paths.diagrams[1, 2].T
    # Differences in steps of all pairs of moments that would be too close; positive where `first` was before.
    time_steps = [
        t - s
        for s in range(len(first_positions))
        for t in range(len(then_positions))
        if too_close[first_positions[s], then_positions[t]]
    ]
    assert evidence.ok and evidence.value == pytest.approx(min(map(abs, time_steps)) * CONTROL_DT_S)
    assert min(abs(step) for step in time_steps if step > 0) == round(evidence.value / CONTROL_DT_S) > 0
    expected = (
        f"closest in time at {evidence.time_s:.2f} s, when Agent_{then} comes to where Agent_{first} has been"
    )
    assert expected in evidence.sentence


def test_space_of_one_agent_is_not_shared(crossing):
    trajectories = (walk(1, [REST, REACHING], 20), idle(2))
    evidence = ShareSpaceCheck((1, 2)).planned(plan_of(BAR, crossing.scene, trajectories))
    assert evidence.ok and evidence.value == np.inf
    assert evidence.sentence == "[Agent_1, Agent_2] use no space that another of them uses at any time"


def test_waiting_in_the_way_of_another_arm_is_detected(crossing):
    trajectories = (idle(1, REACHING), walk(2, [REST, REACHING], 20))
    scene = scene_of(BAR)
    assert not AvoidAgentsCheck((1, 2)).planned(plan_of(BAR, scene, trajectories)).ok


def test_a_check_of_one_agent_covers_all_its_pairs():
    four = team(4)
    assert AvoidAgentsCheck((2,)).pairs(four) == ((1, 2), (2, 3), (2, 4))
    assert AvoidAgentsCheck((1, 3, 4)).pairs(four) == ((1, 3), (1, 4), (3, 4))
    alone = team(1)
    scene = scene_of(alone)
    assert AvoidAgentsCheck((1,)).planned(plan_of(alone, scene, (idle(1),))).ok


def test_objects_in_the_way_are_named():
    scene = scene_of(FOOD)
    builder = Hand(FOOD, scene, 1)
    goal = scene.poses["pot"] @ transform((0, 0, 0.12)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    builder.to(goal, 20, Subgoal(1, "carry", "steak"), "move")  # with the fingers in the knob of the lid
    evidence = AvoidObjectsCheck((1, 2)).planned(plan_of(FOOD, scene, (builder.trajectory, idle(2))))
    assert not evidence.ok and evidence.value < 0.01
    assert "Agent_1, to carry steak (move), comes within" in evidence.sentence
    assert "of lid (panda_" in evidence.sentence and evidence.sentence.endswith("which it may not touch")


def test_the_object_of_a_segment_may_be_touched():
    scene = scene_of(FOOD)
    builder = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.1)
    evidence = AvoidObjectsCheck((1, 2)).planned(plan_of(FOOD, scene, (builder.trajectory, idle(2))))
    assert evidence.ok and evidence.value > 0.003
    assert evidence.sentence.startswith("Agent_")


def test_an_arm_in_the_table_is_named():
    scene = scene_of(BAR)
    aside, low = REST.copy(), REST.copy()
    aside[0] = low[0] = 1.5  # away from the barrier
    low[1] = 1.6
    evidence = AvoidObjectsCheck((1,)).planned(plan_of(BAR, scene, (walk(1, [aside, low], 20), idle(2))))
    assert not evidence.ok and evidence.value < 0.02
    assert "of the table (arm), which it may not touch" in evidence.sentence


def test_a_zone_is_kept_or_entered():
    scene = scene_of(BAR)
    plan = plan_of(BAR, scene, (walk(1, [REST, REACHING], 20), idle(2)))
    empty = KeepOutCheck(1, (0.5, 0.5, 0.0), (0.7, 0.7, 0.5)).planned(plan)
    assert empty.ok and empty.value > 0.2
    assert empty.sentence.startswith(
        "Agent_1 stays out of the keep-out zone (0.5, 0.5, 0.0) to (0.7, 0.7, 0.5) (panda_"
    )
    crossed = KeepOutCheck(1, (-0.1, -0.05, 0.0), (0.1, 0.2, 0.6)).planned(plan)
    assert not crossed.ok and 0 < crossed.time_s < 1
    assert f"Agent_1 at {crossed.time_s:.2f} s enters the keep-out zone" in crossed.sentence
    here = plan.planning_scene.arms[0].tcp(REST)[:3, 3]
    zone = KeepOutCheck(1, tuple((here - 0.05).tolist()), tuple((here + 0.05).tolist()))
    measured = zone.measured(scene, plan)
    assert measured is not None and not measured.ok


def test_a_held_object_stays_out_of_a_zone_too():
    scene = scene_of(FOOD)
    plan = plan_of(FOOD, scene, (idle(1, REST), idle(2)))
    tcp = plan.planning_scene.arms[0].tcp(scene.qpos[0])
    below = transform((*tcp[:2, 3], tcp[2, 3] - 0.3))
    low, high = (below[:3, 3] - 0.05).tolist(), (below[:3, 3] + 0.05).tolist()
    zone = KeepOutCheck(1, tuple(low), tuple(high))
    hanging = replace(scene, poses={**scene.poses, "steak": below})
    for held, ok in ((None, True), ("steak", False)):
        evidence = zone.measured(replace(hanging, held=(held, None)), plan)
        assert evidence is not None and evidence.ok is ok


def test_the_monitor_of_policies_detects_force_and_overlap():
    scene = scene_of(BAR, step=40)
    monitor = PolicyMonitor(BAR)
    assert monitor(scene) is None
    assert monitor(replace(scene, arm_contacts=((1, 2, 0.4),))) is None
    pushed = monitor(replace(scene, arm_contacts=((1, 2, 7.0),)))
    assert pushed is not None
    assert (pushed.check, pushed.agents, pushed.time_s, pushed.value, pushed.bound) == (
        "ValidateSpatialOccupancy", (1, 2), 2.0, 7.0, 1.0,
    )  # fmt: skip
    assert pushed.sentence == "Agent_1 and Agent_2 touch each other with 7 N"
    qpos = scene.qpos.copy()
    qpos[:, :7] = REACHING
    crossed = monitor(replace(scene, qpos=qpos))
    assert crossed is not None and crossed.value < 0
    assert crossed.sentence.startswith(
        f"Agent_1 and Agent_2 overlap by {-crossed.value * 1000:.0f} mm (panda_"
    )


def contact(task, scene, may_touch=None):
    """Contact evidence of the two arms in a scene, with a new `Separation`."""
    touches = (may_touch or dict.fromkeys(task.agents, frozenset())).__getitem__
    return contact_evidence(Separation(task), scene, ((1, 2),), touches)


def test_contact_agrees_with_the_exact_distance():
    rng = np.random.default_rng(0)
    outcomes = set()
    for _ in range(60):
        qpos = scene_of(BAR).qpos
        qpos[:, :7] = REACHING + rng.normal(0, 0.25, (2, 7))
        scene = scene_of(BAR, qpos=qpos)
        exact = PlanningScene(BAR, scene).between(1, 2).distance_m
        found = contact(BAR, scene)
        outcomes.add(found is None)
        assert (found is None) == (exact > 0)
    assert outcomes == {True, False}


def test_a_held_object_is_part_of_its_arm():
    rng = np.random.default_rng(1)
    grip = inverse(FOOD.asset("steak").points["center"].object_from_tcp)
    named = set()
    for _ in range(60):
        start = scene_of(FOOD)
        qpos = start.qpos
        qpos[:, :7] = REACHING + rng.normal(0, 0.25, (2, 7))
        planning_scene = PlanningScene(FOOD, start)
        steak = planning_scene.arms[0].tcp(qpos[0]) @ grip
        scene = replace(start, qpos=qpos, held=("steak", None), poses={**start.poses, "steak": steak})
        loaded = planning_scene.arm(1, qpos[0], attached="steak", tcp_from_object=grip, touches=())
        exact, bare = nearest(loaded, planning_scene.arm(2, qpos[1])), planning_scene.arm(1, qpos[0])
        alone = nearest(bare, planning_scene.arm(2, qpos[1]))
        assert exact is not None and alone is not None
        found = contact(FOOD, scene)
        assert (found is None) == (exact.distance_m > 0)
        if found is not None and alone.distance_m > 0:
            named.add("steak" if "(steak with panda_" in found.sentence else found.sentence)
    assert named == {"steak"}


def measured_with(task, name, pose, held, qpos=None):
    """A start scene in which the object `name` is at another pose and held as in `held`."""
    start = scene_of(task)
    qpos = start.qpos if qpos is None else qpos
    return replace(start, qpos=qpos, held=held, poses={**start.poses, name: pose})


def test_a_gripper_may_touch_its_object_in_another_gripper():
    planning_scene = PlanningScene(FOOD, scene_of(FOOD))
    arm, rest = planning_scene.arms[1], scene_of(FOOD).qpos
    in_fingers = measured_with(FOOD, "steak", arm.links(rest[1])[-1], ("steak", None))
    in_elbow = measured_with(FOOD, "steak", arm.links(rest[1])[5], ("steak", None))
    about = {1: frozenset(), 2: frozenset({"steak"})}
    assert contact(FOOD, in_fingers) is not None
    assert contact(FOOD, in_fingers, about) is None
    assert contact(FOOD, in_elbow, about) is not None
    monitor = PolicyMonitor(FOOD)
    assert monitor(in_fingers) is None
    hit = monitor(in_elbow)
    assert hit is not None and "(steak with panda_link" in hit.sentence


def test_an_object_held_by_two_arms_is_no_obstacle_between_them():
    arm = PlanningScene(BAR, scene_of(BAR)).arms[1]
    pose = arm.links(scene_of(BAR).qpos[1])[5]
    assert contact(BAR, measured_with(BAR, "barrier", pose, ("barrier", None))) is not None
    assert contact(BAR, measured_with(BAR, "barrier", pose, ("barrier", "barrier"))) is None


def test_the_plan_determines_the_object_of_a_gripper():
    scene = scene_of(FOOD)
    builder = Hand(FOOD, scene, 1).grasp("steak", "center")
    taking = plan_of(FOOD, scene, (builder.trajectory, idle(2)))
    standing = plan_of(FOOD, scene, (idle(1, builder.qpos), idle(2)))
    qpos = scene.qpos.copy()
    qpos[0] = [*builder.qpos, 0.02, 0.02]  # fingers pressed into its sides
    held_by_other = measured_with(FOOD, "steak", scene.poses["steak"], (None, "steak"), qpos)
    check = AvoidAgentsCheck((1, 2))
    assert check.measured(replace(held_by_other, step=len(builder.trajectory)), taking) is None
    found = check.measured(held_by_other, standing)
    assert found is not None and not found.ok and "steak" in found.sentence
