"""The schedule search compared with breadth-first search over all joint states."""

from collections import deque
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_exp.coordination.search import (
    UNREACHABLE,
    Infeasible,
    Problem,
    Solution,
    farthest_reachable,
    solve,
    steps_to_go,
)


def brute_force(problem: Problem) -> int | None:
    """Minimum number of steps by breadth-first search, with deadlines; None if infeasible."""
    start, goal = (0,) * len(problem.lengths), problem.lengths
    if any(d[s[0], s[1]] for d, s in ((d, (0, 0)) for d in problem.diagrams.values())):
        return None
    seen, queue = {start}, deque([(start, 0)])
    while queue:
        state, step = queue.popleft()
        if state == goal:
            return step
        options = []
        for position, length, knots in zip(state, problem.lengths, problem.knots, strict=True):
            moves = {position + 1} if position < length else set()
            options.append(moves | ({position} if position in knots else set()))
        for following in product(*options):
            if following in seen or any(
                d[following[i], following[j]] for (i, j), d in problem.diagrams.items()
            ):
                continue
            if any(following[a] < p and step + 1 + p - following[a] > t for a, p, t in problem.deadlines):
                continue
            seen.add(following)
            queue.append((following, step + 1))
    return None


@st.composite
def problems(draw, max_agents: int = 3, max_length: int = 7):
    count = draw(st.integers(2, max_agents))
    lengths = tuple(draw(st.integers(0, max_length)) for _ in range(count))
    knots = tuple(frozenset({0, n, *draw(st.sets(st.integers(0, n), max_size=3))}) for n in lengths)
    diagrams = {}
    for i in range(count):
        for j in range(i + 1, count):
            shape = lengths[i] + 1, lengths[j] + 1
            seed, density = draw(st.integers(0, 10**6)), draw(st.sampled_from([0.0, 0.1, 0.25, 0.4]))
            diagram = np.random.default_rng(seed).random(shape) < density
            if draw(st.booleans()):
                diagram[0, 0] = diagram[-1, -1] = False
            diagrams[i, j] = diagram
    agent = draw(st.integers(0, count - 1))
    latest = draw(st.integers(lengths[agent], 3 * max_length))
    deadlines = ((agent, lengths[agent], latest),) if draw(st.booleans()) else ()
    return Problem(knots, lengths, diagrams, deadlines)


def assert_valid(problem: Problem, positions) -> None:
    assert (positions[0] == 0).all()
    assert tuple(positions[-1]) == problem.lengths
    steps = np.diff(positions, axis=0)
    assert ((steps == 0) | (steps == 1)).all()
    for agent, knots in enumerate(problem.knots):
        waited = positions[:-1, agent][steps[:, agent] == 0]
        assert {*waited.tolist()} <= knots
    for (i, j), diagram in problem.diagrams.items():
        assert not diagram[positions[:, i], positions[:, j]].any()
    for agent, position, latest in problem.deadlines:
        assert np.searchsorted(positions[:, agent], position) <= latest


@pytest.mark.slow
@settings(max_examples=250, deadline=None)
@given(problems())
def test_the_makespan_is_that_of_breadth_first_search(problem):
    expected, answer = brute_force(problem), solve(problem)
    if expected is None:
        assert isinstance(answer, Infeasible) and answer.proven
        return
    assert isinstance(answer, Solution)
    assert_valid(problem, answer.positions)
    assert len(answer.positions) - 1 == expected == answer.bound


@settings(max_examples=60, deadline=None)
@given(problems(max_agents=5, max_length=4))
def test_larger_teams_are_solved_exactly_too(problem):
    expected, answer = brute_force(problem), solve(problem)
    assert (expected is None) == isinstance(answer, Infeasible)
    if isinstance(answer, Solution):
        assert_valid(problem, answer.positions)
        assert len(answer.positions) - 1 == expected == answer.bound


@settings(max_examples=100, deadline=None)
@given(problems(max_agents=4, max_length=4), st.integers(0, 3))
def test_a_small_budget_keeps_the_bound_and_the_rules(problem, budget):
    expected, answer = brute_force(problem), solve(problem, budget)
    if isinstance(answer, Solution):
        assert expected is not None
        assert_valid(problem, answer.positions)
        assert answer.bound <= expected <= len(answer.positions) - 1
    elif answer.proven:
        assert expected is None


@settings(max_examples=100, deadline=None)
@given(problems(max_agents=2))
def test_the_table_of_two_agents_holds_the_remaining_steps(problem):
    problem = Problem(problem.knots, problem.lengths, problem.diagrams)
    table = steps_to_go(problem.diagrams[0, 1], *problem.knots)
    expected = brute_force(problem)
    assert table[0, 0] == (UNREACHABLE if expected is None else expected)


def test_four_agents_through_one_gap():
    """The middle third of the path is exclusive for all four agents; the shortest schedule is known."""
    length, third = 30, 10
    diagram = np.zeros((length + 1, length + 1), dtype=bool)
    diagram[third + 1 : 2 * third, third + 1 : 2 * third] = True
    knots = frozenset(range(0, length + 1, 5))
    pairs = {(i, j): diagram for i in range(4) for j in range(i + 1, 4)}
    problem = Problem((knots,) * 4, (length,) * 4, pairs)
    answer = solve(problem)
    assert isinstance(answer, Solution)
    assert_valid(problem, answer.positions)
    # each agent leaves the knot before the middle one step before its predecessor has left the middle
    assert answer.bound == len(answer.positions) - 1 == length + 3 * (third - 1)


def test_many_stops_and_obstacles_are_solved_to_proven_optimality():
    """Four agents with twelve segments each: too many joint states for an exhaustive search."""
    rng = np.random.default_rng(0)
    length, knots = 240, frozenset(range(0, 241, 20))
    pairs = {}
    for i in range(4):
        for j in range(i + 1, 4):
            pairs[i, j] = np.zeros((length + 1, length + 1), dtype=bool)
            for row, column in rng.integers(5, 180, (8, 2)).tolist():
                pairs[i, j][row : row + 30, column : column + 30] = True
    problem = Problem((knots,) * 4, (length,) * 4, pairs)
    answer = solve(problem)
    assert isinstance(answer, Solution)
    assert_valid(problem, answer.positions)
    assert answer.bound == len(answer.positions) - 1 > length


def test_the_infeasible_pair_is_named():
    wall = np.zeros((5, 5), dtype=bool)
    wall[2, :] = True
    knots = (frozenset({0, 4}),) * 3
    assert solve(Problem(knots, (4, 4, 4), {(0, 2): wall})) == Infeasible((0, 2), proven=True)


def test_the_farthest_reachable_positions():
    wall = np.zeros((6, 6), dtype=bool)
    wall[3, :] = True
    assert farthest_reachable(wall, [0, 2, 5], [0, 5]) == (2, 5)
    assert farthest_reachable(~np.eye(6, dtype=bool), [0, 5], [0, 5]) == (5, 5)
