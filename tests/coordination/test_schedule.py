"""Schedules: rules obeyed, waits only at knots, reasons that point at what to change."""

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
    """Two agents with one subgoal `carry thing<k>` a segment."""
    return tuple(walk(agent, KEYS[: len(steps) + 1], steps) for agent, steps in ((1, first), (2, second)))


def found(trajectories, diagrams=None, rules=()) -> Schedule:
    """A schedule that there has to be."""
    timed = schedule(trajectories, diagrams, rules)
    assert isinstance(timed, Schedule), timed
    return timed


def moves(timed: Schedule, trajectories) -> None:
    """Every schedule starts at 0, ends at the end, moves by at most one and waits only at knots."""
    steps = np.diff(timed.positions, axis=0)
    assert (timed.positions[0] == 0).all() and ((steps == 0) | (steps == 1)).all()
    assert timed.positions[-1].tolist() == [len(t) for t in trajectories]
    for k, trajectory in enumerate(trajectories):
        assert {*timed.positions[:-1, k][steps[:, k] == 0].tolist()} <= {*trajectory.knots}
    assert timed.makespan_bound <= len(timed)


def moving(timed: Schedule, agent: int, start: int) -> int:
    """The first control step at which an agent is past a position."""
    return int(np.searchsorted(timed.positions[:, agent - 1], start, "right"))


def arrived(timed: Schedule, agent: int, end: int) -> int:
    return int(np.searchsorted(timed.positions[:, agent - 1], end))


def test_free_agents_move_at_once():
    trajectories = pair((10, 20), (5, 5, 5))
    timed = found(trajectories)
    moves(timed, trajectories)
    assert len(timed) == timed.makespan_bound == 30


def test_an_idle_agent_stands_still_and_an_empty_plan_takes_no_time():
    trajectories = (*pair()[:1], idle(2))
    timed = found(trajectories)
    moves(timed, trajectories)
    assert len(timed) == 30
    assert len(found((idle(1), idle(2)))) == 0


def test_one_after_the_other_through_a_shared_middle():
    trajectories = pair()
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[11:20, 11:20] = True
    timed = found(trajectories, {(1, 2): diagram})
    moves(timed, trajectories)
    assert not diagram[timed.positions[:, 0], timed.positions[:, 1]].any()
    assert len(timed) == timed.makespan_bound == 39  # the second one waits before the middle


@pytest.mark.parametrize("seed", range(20))
def test_with_slack_nobody_meets_who_is_late(seed: int):
    """Wherever one agent is behind its schedule by no more than that, or before it."""
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
    moves(timed, pair())
    assert len(tight) <= len(timed)
    first, second = timed.positions.T
    for late in range(slack + 1):
        before = np.maximum(np.arange(len(first)) - late, 0)
        assert not diagram[first[before], second].any() and not diagram[first, second[before]].any()


def test_who_pauses_hesitates_unless_another_is_in_the_way():
    trajectories = pair()
    timed = schedule(trajectories, delays=Delays(0, {(1, 10): 7}))
    assert isinstance(timed, Schedule) and timed.hesitates is not None
    moves(timed, trajectories)
    assert np.flatnonzero(timed.hesitates[:, 0]).tolist() == list(range(11, 18))
    assert not timed.hesitates[:, 1].any()
    done, meant = scheduled_actions(trajectories, timed), intended_actions(trajectories, timed)
    np.testing.assert_array_equal(done[10:17, 0], np.tile(trajectories[0].path()[10], (7, 1)))
    np.testing.assert_array_equal(meant[10:16, 0], np.tile(trajectories[0].path()[11], (6, 1)))
    np.testing.assert_array_equal(meant[16, 0], done[16, 0])  # what follows begins at rest
    rest = ~timed.hesitates[1:]
    np.testing.assert_array_equal(done[rest], meant[rest])

    diagram = np.zeros((31, 31), dtype=bool)
    diagram[11:20, :25] = True  # the first one may not go on before the other is at 25
    waiting = schedule(trajectories, {(1, 2): diagram}, delays=Delays(0, {(1, 10): 20}))
    assert isinstance(waiting, Schedule) and waiting.hesitates is not None
    assert np.flatnonzero(waiting.hesitates[:, 0]).tolist() == list(range(25, 31))


@pytest.mark.parametrize("pause", range(1, 8))
def test_what_is_meant_keeps_the_limits_where_an_agent_hesitates(pause):
    """Motion that goes on at the limit, whether it goes back from there or on."""
    limits = JointLimits(0.9, 0.9)
    out, back = np.zeros((2, 7)), np.zeros((2, 7))
    out[1, :2] = back[0, :2] = 0.6, -0.4
    back[1, 1] = -0.8
    segments = tuple(
        Segment(1, Subgoal(1, "home"), "move", points, np.full(len(points), 1.0))
        for points in (parameterise(out, limits), parameterise(back, limits))
    )
    trajectories = (Trajectory(1, np.zeros(7), 1.0, segments),)
    timed = schedule(trajectories, delays=Delays(0, {(1, len(segments[0])): pause}))
    assert isinstance(timed, Schedule) and timed.hesitates is not None
    assert timed.hesitates.sum() == pause
    meant = intended_actions(trajectories, timed)[:, 0, :7]
    velocity = np.diff(meant, axis=0, prepend=np.zeros((1, 7))) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0, prepend=np.zeros((1, 7))) / CONTROL_DT_S
    assert np.abs(velocity).max() <= 1.002 * limits.velocity_rad_s
    assert np.abs(acceleration).max() <= 1.002 * limits.acceleration_rad_s2


def test_swapping_the_agents_swaps_the_schedule_length():
    rng = np.random.default_rng(0)
    diagram = rng.random((31, 26)) < 0.02
    diagram[0, 0] = diagram[-1, -1] = False
    a, b = pair((10, 10, 10), (5, 10, 10))
    forward = found((a, b), {(1, 2): diagram})
    swapped = found((walk(1, KEYS[:4], (5, 10, 10)), walk(2, KEYS[:4], (10, 10, 10))), {(1, 2): diagram.T})
    assert len(forward) == len(swapped)


def test_order_of_subgoals():
    trajectories = pair()
    rule = BeforeCheck(Step(2, "carry", "thing1"), Step(1, "carry", "thing0"))
    timed = found(trajectories, rules=[rule])
    moves(timed, trajectories)
    assert moving(timed, 1, 0) >= arrived(timed, 2, 20)
    assert len(timed) == timed.makespan_bound == 49


def test_a_whole_task_before_another():
    trajectories = pair((10,), (12,))
    timed = found(trajectories, rules=[BeforeCheck(Step(1), Step(2))])
    moves(timed, trajectories)
    assert moving(timed, 2, 0) >= arrived(timed, 1, 10)


@pytest.mark.parametrize(
    ("first", "then"), [(Step(2), Step(1)), (Step(2, "carry", "thing0"), Step(1, "carry", "thing1"))]
)
def test_a_pause_after_another_agent(first, then):
    """At the end of the other's path, and in the middle of it."""
    trajectories = pair()
    rule = BeforeCheck(first, then, wait_s=0.45)
    timed = found(trajectories, rules=[rule])
    moves(timed, trajectories)
    end = span(first, trajectories[1])
    start = span(then, trajectories[0])
    assert end is not None and start is not None
    assert moving(timed, 1, start[0]) >= arrived(timed, 2, end[1]) + 9


def test_simultaneous_starts_wait_for_each_other():
    trajectories = pair((10, 10, 10), (25, 10))
    steps = (Step(1, "carry", "thing1"), Step(2, "carry", "thing1"))
    for within_s in (0.0, 0.2):
        timed = found(trajectories, rules=[TogetherCheck(steps, within_s)])
        moves(timed, trajectories)
        apart = abs(moving(timed, 1, 10) - moving(timed, 2, 25))
        assert apart <= within_s * 20 + 1e-9


def test_simultaneous_holds_for_a_bound_longer_than_the_segments():
    """An agent may finish its first segment and rest; that must not let the other one off the hook."""
    trajectories = pair((4, 4, 4), (40, 4))
    steps = (Step(1, "carry", "thing0"), Step(2, "carry", "thing1"))
    timed = found(trajectories, rules=[TogetherCheck(steps, 0.5)])
    moves(timed, trajectories)
    assert abs(moving(timed, 1, 0) - moving(timed, 2, 40)) <= 10


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
    timed = found(trajectories)
    moves(timed, trajectories)
    a, b = np.clip(timed.positions[:, 0] - 10, 0, 12), np.clip(timed.positions[:, 1] - 17, 0, 12)
    assert (a == b).all()
    assert len(timed) == 29


def test_joined_segments_of_different_length_are_refused():
    trajectories = walk(1, KEYS[:2], 10, joined="lift barrier"), walk(2, KEYS[:2], 12, joined="lift barrier")
    answer = schedule(trajectories)
    assert isinstance(answer, Violation)
    assert (
        answer.sentence
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


def test_rules_about_what_is_not_planned_are_void():
    trajectories = pair()
    rules = [
        BeforeCheck(Step(1, "lift", "lid"), Step(2)),
        TogetherCheck((Step(1, "lift", "lid"), Step(2))),
        DeadlineCheck(Step(1, "lift", "lid"), 0.1),
    ]
    timed = found(trajectories, rules=rules)
    assert len(timed) == 30


def blocked(diagram, rules=(), trajectories=None):
    answer = schedule(trajectories or pair(), {(1, 2): diagram}, rules)
    assert isinstance(answer, Violation)
    assert answer.check == "ValidateScheduling"
    return answer


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
    """A forbidden band over the first and the last column: no timing helps, a path has to change."""
    diagram = np.zeros((31, 31), dtype=bool)
    if blocker == 2:
        diagram[14, :] = True
    else:
        diagram[:, 14] = True
    answer = blocked(diagram)
    other = 3 - blocker
    assert answer.agents == (1, 2)
    assert answer.sentence == (
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
    """Each must pass where the other one has to go: a diagonal wall."""
    diagram = np.zeros((31, 31), dtype=bool)
    diagram[np.arange(31), 30 - np.arange(31)] = True
    diagram[0, 30] = diagram[30, 0] = True
    diagram[np.arange(30), 29 - np.arange(30)] = True
    reason = blocked(diagram).sentence
    assert reason.startswith(("Agent_1 and Agent_2 block each other", "where Agent_"))


def test_reason_contradicting_orders():
    orders = [BeforeCheck(Step(1), Step(2)), BeforeCheck(Step(2), Step(1))]
    answer = schedule(pair(), rules=orders)
    assert isinstance(answer, Violation)
    assert answer.sentence == (
        "the constraints on the order of Agent_1 and Agent_2 contradict one another: they get no further "
        "than Agent_1 0.00 s along its own way, to carry thing0 (move) and Agent_2 0.00 s along its own way, "
        "to carry thing0 (move); drop or change one of them"
    )


def test_reason_three_agents_in_a_circle():
    trajectories = tuple(walk(agent, KEYS[:2], 5) for agent in (1, 2, 3))
    orders = [BeforeCheck(Step(a), Step(b)) for a, b in ((1, 2), (2, 3), (3, 1))]
    answer = schedule(trajectories, rules=orders)
    assert isinstance(answer, Violation)
    assert (
        answer.sentence
        == "every pair of agents could pass, but not all together; let some of them finish first"
    )


def test_reason_out_of_budget():
    rng = np.random.default_rng(0)
    trajectories = tuple(walk(agent, KEYS, 5) for agent in (1, 2, 3, 4))
    diagrams = {}
    for pair_ in ((i, j) for i in range(1, 5) for j in range(i + 1, 5)):
        diagrams[pair_] = rng.random((21, 21)) < 0.05
        diagrams[pair_][0, 0] = diagrams[pair_][-1, -1] = False
    answer = schedule(trajectories, diagrams, budget=1)
    assert isinstance(answer, Violation)
    assert answer.sentence == (
        "no schedule was found within the search budget; plan fewer subgoals at once or one after the other"
    )


def test_serial_takes_turns_in_the_order_of_the_plan():
    trajectories = pair((3, 4), (5, 6))
    goals = [s.subgoal for t in trajectories for s in t.segments]
    timed = sequential(trajectories, Proposal((goals[2], goals[0], goals[1], goals[3]), ()))
    moves(timed, trajectories)
    assert len(timed) == 18
    assert arrived(timed, 2, 5) == 5 and arrived(timed, 1, 7) == 12 and arrived(timed, 2, 11) == 18
    assert (np.diff(timed.positions, axis=0).sum(axis=1) == 1).all()


def test_serial_lets_those_make_room_first_whom_the_plan_does_not_name():
    trajectories = pair((3,), (5,))
    assert len(sequential(trajectories, Proposal((), ()))) == 8
    timed = sequential(trajectories, Proposal((trajectories[0].segments[0].subgoal,), ()))
    assert arrived(timed, 2, 5) == 5 and arrived(timed, 1, 3) == 8


def test_actions_are_the_next_row_of_each_path():
    trajectories = pair((3,), (5, 2))
    timed = found(trajectories)
    commands = scheduled_actions(trajectories, timed)
    assert commands.shape == (7, 2, 8)
    for k, trajectory in enumerate(trajectories):
        assert (commands[:, k] == trajectory.path()[timed.positions[1:, k]]).all()
    assert commands[-1, 0, :7] == pytest.approx(KEYS[1])


def test_agents_must_be_all_and_in_order():
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
