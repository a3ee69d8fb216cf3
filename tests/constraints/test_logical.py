"""Checks of interaction points, directions and gripper heights, planned and measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.constraints import Paths, Plan
from rf_exp.constraints.checks.direction import ORIENTATIONS, DirectionCheck
from rf_exp.constraints.checks.interaction import ContactAtCheck, PlaceAtCheck
from rf_exp.constraints.checks.same_height import SameHeightCheck, _first_carrying_span
from rf_exp.coordination import schedule
from rf_exp.findings import Finding
from rf_exp.transforms import transform
from rf_exp.types import ConstraintSet, Schedule, Subgoal
from tests.constraints.robots import Hand, idle, real, scene_of

BAR, FOOD = real("lift_barrier"), real("place_food")
FULL, WITHOUT_TIME = ConstraintSet("full"), ConstraintSet("logical_spatial", temporal=False)


def plan_of(task, scene, *trajectories, row=FULL) -> Plan:
    timed = schedule(trajectories)
    assert isinstance(timed, Schedule)
    return Plan(Paths(task, row, scene, trajectories), timed)


@pytest.fixture(scope="module")
def grasp() -> Plan:
    scene = scene_of(BAR)
    return plan_of(
        BAR, scene, Hand(BAR, scene, 1).grasp("barrier", "left").trajectory, idle(2, scene.qpos[1, :7])
    )


def shifted(shift_m) -> Plan:
    scene = scene_of(BAR)
    builder = Hand(BAR, scene, 1).grasp("barrier", "left", shift_m=shift_m)
    return plan_of(BAR, scene, builder.trajectory, idle(2))


def test_contact_at_the_annotated_point(grasp):
    evidence = ContactAtCheck(1, "barrier", "left").planned(grasp)
    assert evidence.ok and evidence.value < 1e-3 and evidence.bound == 0.01
    assert evidence.time_s == pytest.approx(1.5)


def test_contact_at_another_point_or_beside_it():
    far = ContactAtCheck(1, "barrier", "right").planned(shifted((0, 0, 0)))
    assert not far.ok and far.value == pytest.approx(0.444, abs=0.01)
    missed = ContactAtCheck(1, "barrier", "left").planned(shifted((0, 0, 0.03)))
    assert not missed.ok
    assert missed.sentence == "Agent_1 would meet barrier 3.0 cm from its left point (allowed 1.0 cm)"


def test_a_demanded_contact_that_is_never_made(grasp):
    """Agent 2 does not move, but the constraint demands its grasp."""
    position = ContactAtCheck(2, "barrier", "right").planned(grasp)
    assert not position.ok and position.value > position.bound
    assert position.sentence == (
        "Agent_2 must meet barrier at its right point, but Agent_2 neither holds barrier nor makes contact "
        "with it in this plan; its subgoals that move: none"
    )
    direction = DirectionCheck(2, "barrier", "perpendicular").planned(grasp)
    assert not direction.ok and direction.value > direction.bound
    assert direction.sentence.startswith(
        "the gripper of Agent_2 must be perpendicular at barrier, but Agent_2"
    )


def test_the_reason_lists_the_subgoals_of_the_agent():
    scene = scene_of(FOOD)
    plan = plan_of(FOOD, scene, Hand(FOOD, scene, 1).grasp("steak", "center").trajectory, idle(2))
    evidence = ContactAtCheck(1, "lid", "knob").planned(plan)
    assert not evidence.ok and evidence.sentence.endswith("its subgoals that move: grasp steak at center")


def test_contact_with_a_held_object_was_made_before():
    lift_plan = lifting((0.1, 0.1))
    for agent, point in ((1, "left"), (2, "right")):
        assert ContactAtCheck(agent, "barrier", point).planned(lift_plan).ok
        assert DirectionCheck(agent, "barrier", "perpendicular").planned(lift_plan).ok


def test_the_target_of_placing_need_not_be_touched():
    scene = scene_of(FOOD)
    builder = Hand(FOOD, scene, 1).grasp("steak", "center")
    above = transform((0, 0, 0.1)) @ builder.arm.tcp(builder.qpos)
    builder.to(
        above, 20, Subgoal(1, "place", "steak", target="pot", target_point="inside"), "lower", {"steak"}
    )
    plan = plan_of(FOOD, scene, builder.trajectory, idle(2))
    assert DirectionCheck(1, "pot", "vertical").planned(plan).ok
    assert not DirectionCheck(1, "lid", "vertical").planned(plan).ok


def measured(plan: Plan, position: int, **changes):
    qpos = plan.scene.qpos.copy()
    qpos[0, :7] = plan.trajectories[0].path()[position, :7]
    return replace(plan.scene, step=int(np.searchsorted(plan.positions(1), position)), qpos=qpos, **changes)


def test_measured_contact_is_judged_once_the_fingers_have_closed(grasp):
    check = ContactAtCheck(1, "barrier", "left")
    closed = grasp.trajectories[0].knots[-1]
    assert check.measured(measured(grasp, closed - 1), grasp) is None
    met = check.measured(measured(grasp, closed), grasp)
    assert met is not None and met.ok
    poses = {"barrier": transform((0.0, 0.0, 0.05)) @ grasp.scene.poses["barrier"]}
    missed = check.measured(measured(grasp, closed, poses=poses), grasp)
    assert missed is not None and not missed.ok
    assert missed.sentence == "Agent_1 meets barrier 5.0 cm from its left point (allowed 3.0 cm)"


def test_measured_direction_is_judged_once_the_fingers_have_closed(grasp):
    check = DirectionCheck(1, "barrier", "perpendicular")
    closed = grasp.trajectories[0].knots[-1]
    assert check.measured(measured(grasp, closed - 3), grasp) is None
    met = check.measured(measured(grasp, closed), grasp)
    assert met is not None and met.ok
    tipped = grasp.scene.poses["barrier"] @ transform(rotation=Rotation.from_euler("y", 30, degrees=True))
    missed = check.measured(measured(grasp, closed, poses={"barrier": tipped}), grasp)
    assert missed is not None and not missed.ok and missed.value == pytest.approx(30, abs=2)


def tilted(degrees: float) -> Plan:
    scene = scene_of(BAR)
    builder = Hand(BAR, scene, 1)
    goal = builder.goal("barrier", "left") @ transform(
        rotation=Rotation.from_euler("y", degrees, degrees=True)
    )
    subgoal = Subgoal(1, "grasp", "barrier", "left")
    builder.to(goal @ transform((0, 0, -0.1)), 20, subgoal, "move").to(
        goal, 10, subgoal, "approach", {"barrier"}
    )
    return plan_of(BAR, scene, builder.trajectory, idle(2))


@pytest.mark.parametrize("orientation", ["perpendicular", "vertical", "level"])
def test_a_straight_grasp_has_every_direction_but_the_horizontal(grasp, orientation):
    assert DirectionCheck(1, "barrier", orientation).planned(grasp).ok


def test_a_straight_grasp_is_not_horizontal(grasp):
    evidence = DirectionCheck(1, "barrier", "horizontal").planned(grasp)
    assert not evidence.ok and evidence.value == pytest.approx(90, abs=1)


@pytest.mark.parametrize(("degrees", "ok"), [(5, True), (25, False)])
def test_a_tilted_grasp_is_measured_in_degrees(degrees, ok):
    evidence = DirectionCheck(1, "barrier", "perpendicular").planned(tilted(degrees))
    assert evidence.ok is ok
    assert evidence.value == pytest.approx(degrees, abs=0.5)
    assert evidence.sentence.startswith(
        f"the gripper of Agent_1 is {degrees} deg off the annotated direction at barrier"
    )


def test_every_orientation_word_is_judged(grasp):
    for orientation in ORIENTATIONS:
        assert np.isfinite(DirectionCheck(1, "barrier", orientation).planned(grasp).value)


def test_an_object_is_placed_at_the_place_point():
    scene = scene_of(FOOD)
    for offset_m, ok in ((0.0, True), (0.06, False)):
        builder = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.2)
        assert builder.held is not None
        goal = scene.poses["pot"] @ FOOD.asset("pot").points["inside"].object_from_tcp
        goal[0, 3] += offset_m
        goal[2, 3] += 0.15  # released high: only the horizontal distance counts
        current = builder.arm.tcp(builder.qpos) @ builder.held[1]
        goal[:3, :3] = current[:3, :3]
        subgoal = Subgoal(1, "place", "steak", target="pot", target_point="inside")
        builder.to(goal @ np.linalg.inv(builder.held[1]), 20, subgoal, "lower", {"steak", "pot"})
        check = PlaceAtCheck(1, "pot", "inside")
        evidence = check.planned(plan_of(FOOD, scene, builder.trajectory, idle(2)))
        assert evidence.ok is ok
        assert evidence.value == pytest.approx(offset_m, abs=2e-3)
    assert (
        evidence.sentence == "Agent_1 would put steak 6.0 cm beside the inside point of pot (allowed 4.0 cm)"
    )


def lifting(heights_m, row=FULL, joined: str | None = "lift barrier", task=BAR) -> Plan:
    """Plan in which both arms hold the barrier and lift it, each by its height."""
    start = scene_of(task)
    qpos = start.qpos.copy()
    for agent, point in ((1, "left"), (2, "right")):
        qpos[agent - 1, :7] = Hand(task, start, agent).grasp("barrier", point).qpos
    scene = replace(start, qpos=qpos, held=("barrier", "barrier"))
    builders = [
        Hand(task, scene, agent).hold("barrier").lift(height, joined=joined)
        for agent, height in zip((1, 2), heights_m, strict=True)
    ]
    return plan_of(task, scene, *(builder.trajectory for builder in builders), row=row)


def test_heights_in_lockstep_are_consistent():
    evidence = SameHeightCheck((1, 2)).planned(lifting((0.15, 0.15)))
    assert evidence.ok and evidence.value < 2e-3


def test_heights_that_drift_apart_are_violations():
    evidence = SameHeightCheck((1, 2)).planned(lifting((0.15, 0.10)))
    assert not evidence.ok and evidence.value == pytest.approx(0.05, abs=2e-3)
    assert (
        evidence.sentence == "the gripper heights of [Agent_1, Agent_2] drift 5.0 cm apart (allowed 2.0 cm)"
    )


def test_without_temporal_constraints_only_the_end_counts():
    plan = lifting((0.15, 0.15), row=WITHOUT_TIME, joined=None)
    alone = np.array([[k, 0] for k in range(21)] + [[20, k] for k in range(1, 21)])
    turns = Schedule(alone, 20)
    assert SameHeightCheck((1, 2)).planned(Plan(plan.paths, turns)).ok
    timed = SameHeightCheck((1, 2)).planned(Plan(replace(plan.paths, constraint_set=FULL), turns))
    assert not timed.ok and timed.value == pytest.approx(0.15, abs=2e-3)


def test_measured_heights_of_two_arms_with_one_object():
    plan, check = lifting((0.15, 0.15)), SameHeightCheck((1, 2))
    paths = [trajectory.path()[:, :7] for trajectory in plan.trajectories]
    for positions, ok in (((12, 12), True), ((18, 4), False)):
        qpos = plan.scene.qpos.copy()
        for k in range(2):
            qpos[k, :7] = paths[k][positions[k]]
        evidence = check.measured(replace(plan.scene, step=15, qpos=qpos), plan)
        assert evidence is not None and evidence.ok is ok
    assert check.measured(replace(plan.scene, step=15, held=("barrier", None)), plan) is None


def test_arms_without_a_load_have_no_height_difference(grasp):
    evidence = SameHeightCheck((1, 2)).planned(grasp)
    assert evidence.ok
    assert evidence.finding is Finding.IDLE


def test_heights_are_compared_for_the_common_load_only():
    """Agent_1 has lifted another object before, by another height."""
    task = replace(BAR, objects={**BAR.objects, "blue": real("stack_cube").objects["blue"]})
    together = lifting((0.15, 0.15), joined=None, task=task)
    first, second = together.trajectories
    other = replace(first.segments[0], attached="blue", qpos=first.segments[0].qpos[::-1], joined=None)
    short = {"qpos": other.qpos[-1:], "gripper": other.gripper[-1:]}
    back = replace(other, attached=None, tcp_from_object=None, **short)
    alone = replace(first, start_qpos=first.segments[0].qpos[-1], segments=(other, back, *first.segments))
    paths = replace(together.paths, trajectories=(alone, second))
    timed = schedule((alone, second))
    assert isinstance(timed, Schedule)
    plan = Plan(paths, timed)
    for agent, begin in ((1, 21), (2, 0)):
        assert _first_carrying_span(plan, agent, "barrier") == (begin, len(plan.trajectory(agent)))
    late = timed.positions.copy()
    late[:, 1] = np.clip(np.arange(len(late)) - 21, 0, 20)  # Agent_2 lifts at the same time as Agent_1
    evidence = SameHeightCheck((1, 2)).planned(Plan(plan.paths, Schedule(late, 41)))
    assert evidence.ok and evidence.value < 2e-3
