"""Conditional constraints: zones that are closed for a time, and phases of a lift."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import RoboChecker
from rf_exp.coordination import schedule
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.statements import Proposal, read
from rf_exp.statements.language.notation import vector
from rf_exp.types import ConstraintSet, Scene, Schedule, Subgoal, Trajectory
from tests.constraints.robots import Hand, real, scene_of

FOOD, BAR = real("place_food"), real("lift_barrier")
FULL = ConstraintSet("full")
HALF_M = 0.03


def zone_around(at) -> str:
    low, high = (tuple((np.round(at[:3, 3] + side, 3)).tolist()) for side in (-HALF_M, HALF_M))
    return f"zone {vector(low)} to {vector(high)}"


@pytest.fixture(scope="module")
def food() -> tuple[Scene, tuple[Trajectory, Trajectory], Proposal, str]:
    """Scene, trajectories, proposal and zone: agent 1 grasps the steak in the zone, agent 2 lifts the lid."""
    scene = scene_of(FOOD)
    steak_arm = Hand(FOOD, scene, 1).grasp("steak", "center")
    lid_arm = Hand(FOOD, scene, 2).grasp("lid", "knob").lift(0.12)
    trajectories = steak_arm.trajectory, lid_arm.trajectory
    goals = tuple(dict.fromkeys(s.subgoal for t in trajectories for s in t.segments))
    return scene, trajectories, Proposal(goals, ()), zone_around(steak_arm.arm.tcp(steak_arm.qpos))


def checker(food, sentence: str) -> RoboChecker:
    _, _, proposal, zone = food
    constraint = read(sentence.format(zone=zone), FOOD.vocabulary)
    return RoboChecker(FOOD, replace(proposal, constraints=(constraint,)), FULL)


def violations(checker: RoboChecker, trajectories, scene: Scene, timed: Schedule) -> list[Violation]:
    return checker.check(checker.paths(trajectories, scene), timed).violations


def arrival_step(timed: Schedule, agent: int, trajectory: Trajectory) -> int:
    """The control step at which an agent reaches the end of its path."""
    return int(np.argmax(timed.positions[:, agent - 1] == len(trajectory)))


def test_a_zone_is_closed_until_another_agent_is_done(food) -> None:
    """Scheduling keeps the agent out of the zone; a schedule without waiting is refused."""
    scene, trajectories, _, _ = food
    waiting = checker(food, "Agent_1 must stay out of {zone} until Agent_2 lifts lid.")
    timed = waiting.schedule(waiting.paths(trajectories, scene))
    assert isinstance(timed, Schedule) and not violations(waiting, trajectories, scene, timed)
    assert arrival_step(timed, 1, trajectories[0]) > arrival_step(timed, 2, trajectories[1])
    hurried = schedule(trajectories)
    assert isinstance(hurried, Schedule)
    positions = timed.positions[:, :1], np.minimum(timed.positions[:, 1:], len(trajectories[1]) - 1)
    (found,) = waiting.check(waiting.paths(trajectories, scene), Schedule(np.hstack(positions), 0)).violations
    assert found.cause == "space" and found.agents == (1,) and "enters the keep-out zone" in found.sentence
    closed = checker(food, "Agent_1 must stay out of {zone}.")
    assert isinstance(closed.schedule(closed.paths(trajectories, scene)), Schedule)
    assert violations(closed, trajectories, scene, timed)


def test_a_zone_is_closed_while_an_agent_or_object_is_in_it(food) -> None:
    scene, trajectories, _, _ = food
    timed = schedule(trajectories)
    assert isinstance(timed, Schedule)
    away = checker(food, "Agent_1 must stay out of {zone} while Agent_2 is in it.")
    assert not away.check(
        away.paths(trajectories, scene), timed
    ).violations  # agent 2 lifts the lid outside of it
    beside = checker(food, "Agent_1 must stay out of {zone} while lid is in it.")
    assert not violations(beside, trajectories, scene, timed)


def test_an_object_in_a_zone_closes_it(food) -> None:
    scene, trajectories, _, _ = food
    timed = schedule(trajectories)
    assert isinstance(timed, Schedule)
    for name, closed in (("pot", False), ("steak", True)):
        watched = checker(food, f"Agent_1 must stay out of {{zone}} while the {name} is in it.")
        found = violations(watched, trajectories, scene, timed)
        assert any("enters the keep-out zone" in each.sentence for each in found) is closed


def test_a_measured_arm_in_a_closed_zone_is_detected(food) -> None:
    scene, trajectories, _, _ = food
    waits = checker(food, "Agent_1 must stay out of {zone} until Agent_2 lifts lid.")
    timed = waits.schedule(waits.paths(trajectories, scene))
    assert isinstance(timed, Schedule)
    plan = waits.check(waits.paths(trajectories, scene), timed).plan
    (stay_out,) = (check for check in waits.checks if "zone" in repr(check))
    qpos = scene.qpos.copy()
    qpos[0, :7] = trajectories[0].path()[-1, :7]
    inside = replace(scene, qpos=qpos, held=("steak", None))
    early = stay_out.measured(inside, plan)
    assert early is not None and not early.ok
    done = replace(inside, step=scene.step + len(timed))
    assert stay_out.measured(done, plan) is None


def test_waits_without_a_matching_subgoal_are_refused(food) -> None:
    for sentence, reason in {
        "Agent_1 must stay out of {zone} until lid is on the table.": "no subgoal puts lid there",
        "Agent_1 must stay out of {zone} until Agent_2 places lid.": "is no subgoal of Agent_2",
    }.items():
        with pytest.raises(ArgumentError, match=reason):
            checker(food, sentence)


def test_an_object_on_the_table_was_placed_there() -> None:
    """`until the lid is on the table` waits for the agent that places it; `lets go of`, for the same."""
    lid_down = Proposal(
        (Subgoal(2, "place", "lid", target="aside"), Subgoal(1, "grasp", "steak", "center")), ()
    )
    for sentence in (
        "Agent_1 waits until the lid is on the table",
        "Agent_1 waits until Agent_2 lets go of the lid",
    ):
        stated = read(sentence, FOOD.vocabulary)
        code = RoboChecker(FOOD, replace(lid_down, constraints=(stated,)), FULL).code
        assert repr(code) == "VS([Agent_2, Agent_1], sequential, place lid)"
    in_pot = Proposal((Subgoal(1, "place", "steak", target="pot", target_point="inside"),), ())
    for surface, found in (("the pot", True), ("the table", False)):
        stated = read(f"Agent_2 waits until the steak is on {surface}", FOOD.vocabulary)
        proposal = replace(in_pot, constraints=(stated,))
        if found:
            code = RoboChecker(FOOD, proposal, FULL).code
            assert repr(code) == "VS([Agent_1, Agent_2], sequential, place steak)"
        else:
            with pytest.raises(ArgumentError, match="no subgoal puts steak there"):
                RoboChecker(FOOD, proposal, FULL)


def lifting(heights_m: tuple[float, float]) -> tuple[Scene, tuple[Trajectory, ...]]:
    """Scene and trajectories in which both arms hold the barrier and lift it, each by its height."""
    start = scene_of(BAR)
    qpos = start.qpos.copy()
    for agent, point in ((1, "left"), (2, "right")):
        qpos[agent - 1, :7] = Hand(BAR, start, agent).grasp("barrier", point).qpos
    scene = replace(start, qpos=qpos, held=("barrier", "barrier"))
    builders = [
        Hand(BAR, scene, agent).hold("barrier").lift(height, joined="lift barrier")
        for agent, height in zip((1, 2), heights_m, strict=True)
    ]
    return scene, tuple(builder.trajectory for builder in builders)


@pytest.mark.parametrize(("heights_m", "ok"), [((0.15, 0.15), True), ((0.15, 0.10), False)])
def test_heights_are_the_same_in_a_phase(heights_m, ok) -> None:
    scene, trajectories = lifting(heights_m)
    goals = tuple(each.segments[0].subgoal for each in trajectories)
    stated = read("Agent_1 and Agent_2 must keep the same height when lifting the barrier", BAR.vocabulary)
    watched = RoboChecker(BAR, Proposal(goals, (stated,)), FULL)
    assert repr(watched.code) == "VD([Agent_1, Agent_2], consistent height, lift)"
    timed = watched.schedule(watched.paths(trajectories, scene))
    assert isinstance(timed, Schedule)
    found = [
        each for each in violations(watched, trajectories, scene, timed) if each.check == "ValidateDirection"
    ]
    assert (not found) is ok


@pytest.mark.parametrize(("direction", "ok"), [("vertical", True), ("horizontal", False), ("level", True)])
def test_a_gripper_keeps_its_direction_throughout_a_phase(direction, ok) -> None:
    scene, trajectories = lifting((0.15, 0.15))
    goals = tuple(each.segments[0].subgoal for each in trajectories)
    stated = read(f"Agent_1 must keep its gripper {direction} when lifting barrier", BAR.vocabulary)
    watched = RoboChecker(BAR, Proposal(goals, (stated,)), FULL)
    assert (
        not isinstance(watched.code, type(None))
        and repr(watched.code) == f"VD(Agent_1, barrier, {direction}, lift)"
    )
    timed = watched.schedule(watched.paths(trajectories, scene))
    assert isinstance(timed, Schedule)
    found = [
        each for each in violations(watched, trajectories, scene, timed) if each.check == "ValidateDirection"
    ]
    assert (not found) is ok
    check = next(check for check in watched.checks if check.name == "ValidateDirection")
    plan = watched.check(watched.paths(trajectories, scene), timed).plan
    qpos = scene.qpos.copy()
    qpos[0, :7] = trajectories[0].path()[-1, :7]
    now = check.measured(replace(scene, qpos=qpos, step=len(timed)), plan)
    assert now is not None and now.ok is ok


def test_perpendicular_is_about_contact() -> None:
    with pytest.raises(ArgumentError, match="say vertical, horizontal or level"):
        read("The gripper of Agent_1 must be perpendicular to barrier when lifting it", BAR.vocabulary)
