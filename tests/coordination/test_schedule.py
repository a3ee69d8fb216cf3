"""Schedules: rules are kept, waits only at knots, and failures explain what to change."""

import numpy as np
import pytest

from rf_exp.constraints.checks.before import BeforeCheck
from rf_exp.constraints.checks.deadline import DeadlineCheck
from rf_exp.constraints.checks.together import TogetherCheck
from rf_exp.constraints.phases import span
from rf_exp.coordination import Delays, intended_actions, schedule, scheduled_actions, sequential
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.statements import Proposal, Step
from rf_exp.types import CONTROL_DT_S, JointLimits, Schedule, Segment, Subgoal, Trajectory
from tests.constraints.robots import REST, idle, walk

KEYS = [REST + 0.1 * k for k in range(5)]


def pair(first=(10, 10, 10), second=(10, 10, 10)):
    """Trajectories of two agents with one subgoal `carry thing<k>` per segment."""
    return tuple(walk(agent, KEYS[: len(steps) + 1], steps) for agent, steps in ((1, first), (2, second)))


def feasible(trajectories, diagrams=None, rules=()) -> Schedule:
    """The schedule; asserts that there is one."""
    timed = schedule(trajectories, diagrams, rules)
    assert isinstance(timed, Schedule), timed
    return timed


def assert_valid(timed: Schedule, trajectories) -> None:
    """Asserts that a schedule starts at 0, reaches the end, advances by at most 1 and waits only at knots."""
    steps = np.diff(timed.positions, axis=0)
    assert (timed.positions[0] == 0).all() and ((steps == 0) | (steps == 1)).all()
    assert timed.positions[-1].tolist() == [len(t) for t in trajectories]
    for k, trajectory in enumerate(trajectories):
        assert {*timed.positions[:-1, k][steps[:, k] == 0].tolist()} <= {*trajectory.knots}
    assert timed.makespan_bound <= len(timed)


def departure_step(timed: Schedule, agent: int, start: int) -> int:
    """The first control step at which an agent is beyond a position."""
    return int(np.searchsorted(timed.positions[:, agent - 1], start, "right"))


def arrival_step(timed: Schedule, agent: int, end: int) -> int:
    return int(np.searchsorted(timed.positions[:, agent - 1], end))


def test_free_agents_move_at_once():
    trajectories = pair((10, 20), (5, 5, 5))
    timed = feasible(trajectories)
    assert_valid(timed, trajectories)
    assert len(timed) == timed.makespan_bound == 30


def test_an_idle_agent_stands_still_and_an_empty_plan_takes_no_time():
    trajectories = (*pair()[:1], idle(2))
    timed = feasible(trajectories)
    assert_valid(timed, trajectories)
    assert len(timed) == 30
    assert len(feasible((idle(1), idle(2)))) == 0


def test_agents_pass_a_shared_region_one_after_the_other():
    trajectories = pair()
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[11:20, 11:20] = True
    timed = feasible(trajectories, {(1, 2): diagram})
    assert_valid(timed, trajectories)
    assert not diagram[timed.positions[:, 0], timed.positions[:, 1]].any()
    assert len(timed) == timed.makespan_bound == 39  # the second agent waits before the middle


@pytest.mark.parametrize("seed", range(20))
def test_with_slack_late_agents_do_not_collide(seed: int):
    """No collision if either agent is late by up to `slack` steps."""
    rng, slack = np.random.default_rng(seed), 6
    diagram = np.zeros((31, 31), dtype=bool)
    for _ in range(2):
        row, column = rng.integers(2, 22, 2)
        diagram[row : row + rng.integers(1, 8), column : column + rng.integers(1, 8)] = True
    tight, timed = (
        schedule(pair(), {(1, 2): diagram}, delays=delays) for delays in (None, Delays(slack, {}))
    )
    assert isinstance(tight, Schedule)
    if not isinstance(timed, Schedule):
        return
    assert_valid(timed, pair())
    assert len(tight) <= len(timed)
    first, second = timed.positions.T
    for late in range(slack + 1):
        before = np.maximum(np.arange(len(first)) - late, 0)
        assert not diagram[first[before], second].any() and not diagram[first, second[before]].any()


def test_a_pausing_agent_hesitates_unless_another_agent_blocks_it():
    trajectories = pair()
    timed = schedule(trajectories, delays=Delays(0, {(1, 10): 7}))
    assert isinstance(timed, Schedule) and timed.hesitates is not None
    assert_valid(timed, trajectories)
    assert np.flatnonzero(timed.hesitates[:, 0]).tolist() == list(range(11, 18))
    assert not timed.hesitates[:, 1].any()
    executed, intended = scheduled_actions(trajectories, timed), intended_actions(trajectories, timed)
    np.testing.assert_array_equal(executed[10:17, 0], np.tile(trajectories[0].path()[10], (7, 1)))
    np.testing.assert_array_equal(intended[10:16, 0], np.tile(trajectories[0].path()[11], (6, 1)))
    np.testing.assert_array_equal(intended[16, 0], executed[16, 0])  # the next motion starts from rest
    rest = ~timed.hesitates[1:]
    np.testing.assert_array_equal(executed[rest], intended[rest])

    diagram = np.zeros((31, 31), dtype=bool)
    diagram[11:20, :25] = True  # the first agent may not go on before the other is at 25
    waiting = schedule(trajectories, {(1, 2): diagram}, delays=Delays(0, {(1, 10): 20}))
    assert isinstance(waiting, Schedule) and waiting.hesitates is not None
    assert np.flatnonzero(waiting.hesitates[:, 0]).tolist() == list(range(25, 31))


@pytest.mark.parametrize("pause", range(1, 8))
def test_intended_actions_keep_the_limits_where_an_agent_hesitates(pause):
    """Motion at the limits, which goes back in one joint after the pause and on in another."""
    limits = JointLimits(0.9, 0.9)
    first_move, second_move = np.zeros((2, 7)), np.zeros((2, 7))
    first_move[1, :2] = second_move[0, :2] = 0.6, -0.4
    second_move[1, 1] = -0.8
    segments = tuple(
        Segment(1, Subgoal(1, "home"), "move", points, np.full(len(points), 1.0))
        for points in (parameterise(first_move, limits), parameterise(second_move, limits))
    )
    trajectories = (Trajectory(1, np.zeros(7), 1.0, segments),)
    timed = schedule(trajectories, delays=Delays(0, {(1, len(segments[0])): pause}))
    assert isinstance(timed, Schedule) and timed.hesitates is not None
    assert timed.hesitates.sum() == pause
    intended = intended_actions(trajectories, timed)[:, 0, :7]
    velocity = np.diff(intended, axis=0, prepend=np.zeros((1, 7))) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0, prepend=np.zeros((1, 7))) / CONTROL_DT_S
    assert np.abs(velocity).max() <= 1.002 * limits.velocity_rad_s
    assert np.abs(acceleration).max() <= 1.002 * limits.acceleration_rad_s2


def test_swapping_the_agents_keeps_the_schedule_length():
    rng = np.random.default_rng(0)
    diagram = rng.random((31, 26)) < 0.02
    diagram[0, 0] = diagram[-1, -1] = False
    a, b = pair((10, 10, 10), (5, 10, 10))
    forward = feasible((a, b), {(1, 2): diagram})
    swapped = feasible((walk(1, KEYS[:4], (5, 10, 10)), walk(2, KEYS[:4], (10, 10, 10))), {(1, 2): diagram.T})
    assert len(forward) == len(swapped)


def test_order_of_subgoals():
    trajectories = pair()
    rule = BeforeCheck(Step(2, "carry", "thing1"), Step(1, "carry", "thing0"))
    timed = feasible(trajectories, rules=[rule])
    assert_valid(timed, trajectories)
    assert departure_step(timed, 1, 0) >= arrival_step(timed, 2, 20)
    assert len(timed) == timed.makespan_bound == 49


def test_a_whole_task_before_another():
    trajectories = pair((10,), (12,))
    timed = feasible(trajectories, rules=[BeforeCheck(Step(1), Step(2))])
    assert_valid(timed, trajectories)
    assert departure_step(timed, 2, 0) >= arrival_step(timed, 1, 10)


@pytest.mark.parametrize(
    ("first", "then"), [(Step(2), Step(1)), (Step(2, "carry", "thing0"), Step(1, "carry", "thing1"))]
)
def test_a_pause_after_another_agent(first, then):
    """After the end of the path of the other agent, and in the middle of it."""
    trajectories = pair()
    rule = BeforeCheck(first, then, wait_s=0.45)
    timed = feasible(trajectories, rules=[rule])
    assert_valid(timed, trajectories)
    end = span(first, trajectories[1])
    start = span(then, trajectories[0])
    assert end is not None and start is not None
    assert departure_step(timed, 1, start[0]) >= arrival_step(timed, 2, end[1]) + 9


def test_simultaneous_starts_wait_for_each_other():
    trajectories = pair((10, 10, 10), (25, 10))
    steps = (Step(1, "carry", "thing1"), Step(2, "carry", "thing1"))
    for within_s in (0.0, 0.2):
        timed = feasible(trajectories, rules=[TogetherCheck(steps, within_s)])
        assert_valid(timed, trajectories)
        difference = abs(departure_step(timed, 1, 10) - departure_step(timed, 2, 25))
        assert difference <= within_s * 20 + 1e-9


def test_simultaneous_holds_for_a_bound_longer_than_the_segments():
    """One agent may finish its segment and rest, which must not cancel the rule for the other."""
    trajectories = pair((4, 4, 4), (40, 4))
    steps = (Step(1, "carry", "thing0"), Step(2, "carry", "thing1"))
    timed = feasible(trajectories, rules=[TogetherCheck(steps, 0.5)])
    assert_valid(timed, trajectories)
    assert abs(departure_step(timed, 1, 0) - departure_step(timed, 2, 40)) <= 10


def test_joined_segments_run_in_lockstep():
    first = walk(1, KEYS[:2], (10,)), walk(2, KEYS[:2], (17,))
    trajectories = tuple(
        type(t)(
            t.agent,
            t.start_qpos,
            t.start_gripper,
            (*t.segments, *walk(t.agent, KEYS[1:3], (12,), joined="lift").segments),
        )
        for t in first
    )
    timed = feasible(trajectories)
    assert_valid(timed, trajectories)
    a, b = np.clip(timed.positions[:, 0] - 10, 0, 12), np.clip(timed.positions[:, 1] - 17, 0, 12)
    assert (a == b).all()
    assert len(timed) == 29


def test_joined_segments_of_different_length_are_refused():
    trajectories = walk(1, KEYS[:2], 10, joined="lift barrier"), walk(2, KEYS[:2], 12, joined="lift barrier")
    violation = schedule(trajectories)
    assert isinstance(violation, Violation)
    assert (
        violation.sentence
        == "Agent_1 and Agent_2 do 'lift barrier' together but one of them plans 0.1 s more; plan it as one "
        "motion"
    )


def test_a_deadline_is_met_or_explained():
    trajectories = pair()
    order = BeforeCheck(Step(1), Step(2))
    assert isinstance(schedule(trajectories, rules=[order, DeadlineCheck(Step(2), 3.0)]), Schedule)
    late = schedule(trajectories, rules=[order, DeadlineCheck(Step(2), 2.0)])
    assert isinstance(late, Violation)
    assert late.agents == (2,)
    assert late.sentence == "Agent_2 cannot be done within 2 s; the shortest schedule needs 2.95 s"


def test_rules_about_unplanned_subgoals_have_no_effect():
    trajectories = pair()
    rules = [
        BeforeCheck(Step(1, "lift", "lid"), Step(2)),
        TogetherCheck((Step(1, "lift", "lid"), Step(2))),
        DeadlineCheck(Step(1, "lift", "lid"), 0.1),
    ]
    timed = feasible(trajectories, rules=rules)
    assert len(timed) == 30


def blocked(diagram, rules=(), trajectories=None):
    violation = schedule(trajectories or pair(), {(1, 2): diagram}, rules)
    assert isinstance(violation, Violation)
    assert violation.check == "ValidateScheduling"
    return violation


def test_reason_already_too_close():
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[0, 0] = True
    assert (
        blocked(diagram).sentence
        == "Agent_1 and Agent_2 already stand too close to each other; move one of them away first"
    )


def test_reason_would_end_too_close():
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[30, 30] = True
    reason = blocked(diagram).sentence
    assert reason.startswith("Agent_1 and Agent_2 would end too close to each other")
    assert "timing cannot help" in reason


@pytest.mark.parametrize("blocker", [1, 2])
def test_reason_a_parked_arm_blocks_the_way(blocker):
    """A forbidden band from the first to the last column: no schedule exists, a path has to change."""
    diagram = np.zeros((31, 31), dtype=bool)
    if blocker == 2:
        diagram[14, :] = True
    else:
        diagram[:, 14] = True
    violation = blocked(diagram)
    other = 3 - blocker
    assert violation.agents == (1, 2)
    assert violation.sentence == (
        f"where Agent_{blocker} stands before and after its motion blocks Agent_{other} 0.70 s along its own "
        f"way, to carry thing1 (move); timing cannot help, Agent_{other} needs another path "
        f"or Agent_{blocker} must yield"
    )


def test_reason_an_idle_arm_blocks_the_way():
    diagram = np.zeros((31, 1), dtype=bool)
    diagram[14] = True
    reason = blocked(diagram, trajectories=(pair()[0], idle(2))).sentence
    assert "where Agent_2 stands before and after its motion blocks Agent_1" in reason


def test_reason_both_block_each_other():
    """A diagonal wall: each must pass where the other has to go."""
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[np.arange(31), 30 - np.arange(31)] = True
    diagram[0, 30] = diagram[30, 0] = True
    diagram[np.arange(30), 29 - np.arange(30)] = True
    reason = blocked(diagram).sentence
    assert reason.startswith(("Agent_1 and Agent_2 block each other", "where Agent_"))


def test_reason_contradicting_orders():
    orders = [BeforeCheck(Step(1), Step(2)), BeforeCheck(Step(2), Step(1))]
    violation = schedule(pair(), rules=orders)
    assert isinstance(violation, Violation)
    assert violation.sentence == (
        "the constraints on the order of Agent_1 and Agent_2 contradict one another: they get no further "
        "than Agent_1 0.00 s along its own way, to carry thing0 (move) and Agent_2 0.00 s along its own way, "
        "to carry thing0 (move); drop or change one of them"
    )


def test_reason_three_agents_in_a_circle():
    trajectories = tuple(walk(agent, KEYS[:2], 5) for agent in (1, 2, 3))
    orders = [BeforeCheck(Step(a), Step(b)) for a, b in ((1, 2), (2, 3), (3, 1))]
    violation = schedule(trajectories, rules=orders)
    assert isinstance(violation, Violation)
    assert (
        violation.sentence
        == "every pair of agents could pass, but not all together; let some of them finish first"
    )


def test_reason_out_of_budget():
    rng = np.random.default_rng(0)
    trajectories = tuple(walk(agent, KEYS, 5) for agent in (1, 2, 3, 4))
    diagrams = {}
    for agents in ((i, j) for i in range(1, 5) for j in range(i + 1, 5)):
        diagrams[agents] = rng.random((21, 21)) < 0.05
        diagrams[agents][0, 0] = diagrams[agents][-1, -1] = False
    violation = schedule(trajectories, diagrams, budget=1)
    assert isinstance(violation, Violation)
    assert violation.sentence == (
        "no schedule was found within the search budget; plan fewer subgoals at once or one after the other"
    )


def test_sequential_schedules_follow_the_order_of_the_plan():
    trajectories = pair((3, 4), (5, 6))
    goals = [s.subgoal for t in trajectories for s in t.segments]
    timed = sequential(trajectories, Proposal((goals[2], goals[0], goals[1], goals[3]), ()))
    assert_valid(timed, trajectories)
    assert len(timed) == 18
    assert (
        arrival_step(timed, 2, 5) == 5
        and arrival_step(timed, 1, 7) == 12
        and arrival_step(timed, 2, 11) == 18
    )
    assert (np.diff(timed.positions, axis=0).sum(axis=1) == 1).all()


def test_in_sequential_schedules_agents_without_subgoals_move_first():
    trajectories = pair((3,), (5,))
    assert len(sequential(trajectories, Proposal((), ()))) == 8
    timed = sequential(trajectories, Proposal((trajectories[0].segments[0].subgoal,), ()))
    assert arrival_step(timed, 2, 5) == 5 and arrival_step(timed, 1, 3) == 8


def test_actions_are_the_next_row_of_each_path():
    trajectories = pair((3,), (5, 2))
    timed = feasible(trajectories)
    commands = scheduled_actions(trajectories, timed)
    assert commands.shape == (7, 2, 8)
    for k, trajectory in enumerate(trajectories):
        assert (commands[:, k] == trajectory.path()[timed.positions[1:, k]]).all()
    assert commands[-1, 0, :7] == pytest.approx(KEYS[1])


def test_trajectories_must_be_of_all_agents_in_order():
    a, b = pair()
    with pytest.raises(
        ArgumentError, match=r"trajectories are of agents \[2, 1\]; expected one for each agent 1 to N"
    ):
        schedule((b, a))


def test_diagrams_must_fit():
    with pytest.raises(
        ArgumentError, match=r"diagram of agents \(1, 2\) has shape \(3, 3\); expected \(31, 31\)"
    ):
        schedule(pair(), {(1, 2): np.zeros((3, 3), dtype=bool)})
    with pytest.raises(ArgumentError, match=r"diagram of agents \(2, 1\); expected i < j of agents 1 to 2"):
        schedule(pair(), {(2, 1): np.zeros((31, 31), dtype=bool)})
