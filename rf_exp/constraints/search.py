"""The shortest schedule of agents on fixed paths: integers in, integers out.

A joint state holds a path position for each agent. In one control step every agent moves on by one
position or waits, and it waits only at its knots. Forbidden are pairs of positions (coordination
diagrams). Two agents are solved exactly by a dynamic programme over their diagram; its table of
remaining steps is a lower bound for any larger team. A larger team is first scheduled agent by agent
in every order; unless the best of these meets the bound, A* under the bounds of all pairs looks for
a shorter schedule, and when it runs out of its budget its frontier still proves a bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import combinations, permutations, product
from operator import sub

import numpy as np
from numpy.typing import NDArray

Pair = tuple[int, int]
Diagram = NDArray[np.bool_]  # (P_i, P_j) True = forbidden

UNREACHABLE = np.iinfo(np.int32).max // 4
BUDGET = 8_000  # joint states that the exact search may expand
GREED = 4.0  # weight of the remaining steps where any schedule will do


@dataclass(frozen=True)
class Problem:
    """Agents from 0. `diagrams` has an entry (i, j), i < j, for every pair that is not free."""

    knots: tuple[frozenset[int], ...]  # positions at which an agent may wait; the last one included
    lengths: tuple[int, ...]  # last position of each agent
    diagrams: Mapping[Pair, Diagram]
    deadlines: tuple[tuple[int, int, int], ...] = ()  # (agent, position, latest step)


@dataclass(frozen=True)
class Found:
    """A schedule and what is proven about it."""

    positions: NDArray[np.int64]  # (T + 1, N)
    bound: int  # no schedule has fewer steps


@dataclass(frozen=True)
class Impossible:
    """No schedule exists (`pair` alone is to blame if given), or none was found within the budget."""

    pair: Pair | None
    proven: bool


def remaining(diagram: Diagram, knots_a: frozenset[int], knots_b: frozenset[int]) -> NDArray[np.int32]:
    """(P, Q) fewest steps from each pair of positions to both ends; UNREACHABLE where there is no way.

    Exact, by one backward pass: every step moves at least one agent on (both waiting gains nothing).
    """
    rows, columns = diagram.shape
    waits_b = np.isin(np.arange(columns), list(knots_b))
    steps = np.full((rows + 1, columns + 1), UNREACHABLE, dtype=np.int32)
    offsets = np.arange(columns, dtype=np.int32)
    for row in range(rows - 1, -1, -1):
        below = steps[row + 1]
        best = np.minimum(below[1:], np.where(waits_b, below[:-1], UNREACHABLE)) + 1
        if row == rows - 1:
            best[-1] = 0
        best[diagram[row]] = UNREACHABLE
        if row in knots_a:  # this agent may wait here while the other one moves on
            start = 0
            for stop in [*np.flatnonzero(diagram[row]).tolist(), columns]:
                run = slice(start, stop)
                ahead = (best[run] + offsets[run])[::-1]
                best[run] = np.minimum.accumulate(ahead)[::-1] - offsets[run]
                start = stop + 1
        steps[row, :-1] = np.minimum(best, UNREACHABLE)
    return steps[:-1, :-1]


def solve(problem: Problem, budget: int = BUDGET) -> Found | Impossible:
    """The shortest schedule, or the best one found within the budget with its proven bound."""
    agents = range(len(problem.lengths))
    tables: dict[Pair, NDArray[np.int32]] = {}
    for i, j in combinations(agents, 2):
        diagram = problem.diagrams.get((i, j))
        if diagram is not None and diagram.any():
            tables[i, j] = remaining(diagram, problem.knots[i], problem.knots[j])
            if tables[i, j][0, 0] >= UNREACHABLE:
                return Impossible((i, j), proven=True)

    bound = max([*problem.lengths, *(int(table[0, 0]) for table in tables.values())])
    best = _in_some_order(problem, bound) if len(agents) > 2 else None
    if best is not None and len(best) - 1 == bound:
        return Found(best, bound)
    shorter_than = UNREACHABLE if best is None else len(best) - 1
    better, bound, settled = _search(problem, tables, 1.0, budget, shorter_than)
    if better is not None:
        return Found(better, bound)
    if best is not None:
        return Found(best, shorter_than if settled else bound)
    if settled:
        return Impossible(None, proven=True)
    some, _, _ = _search(problem, tables, GREED, budget, UNREACHABLE)
    return Impossible(None, proven=False) if some is None else Found(some, bound)


def _in_some_order(problem: Problem, bound: int) -> NDArray[np.int64] | None:
    """The best schedule in which each agent takes its fastest way past the ones before it in some order."""
    best: NDArray[np.int64] | None = None
    for order in permutations(range(len(problem.lengths))):
        horizon = sum(problem.lengths) if best is None else len(best) - 2
        if horizon < bound:
            break
        placed: dict[int, NDArray[np.int64]] = {}
        for agent in order:
            way = _past(problem, agent, placed, horizon)
            if way is None:
                break
            placed[agent] = way
        else:
            positions = np.stack([placed[agent] for agent in range(len(order))], axis=1)
            best = positions[: 1 + int(np.argmax((positions == problem.lengths).all(axis=1)))]
    return best


def _past(
    problem: Problem, agent: int, placed: Mapping[int, NDArray[np.int64]], horizon: int
) -> NDArray[np.int64] | None:
    """(horizon + 1,) positions of an agent that arrives as early as the placed ones let it.

    None if they do not let it. The only choice is when to leave each knot, so sets of arrival times
    are all that is kept.
    """
    length = problem.lengths[agent]
    blocked = np.zeros((horizon + length + 2, length + 1), dtype=bool)  # (t, position); free past the horizon
    for other, positions in placed.items():
        pair = (agent, other) if agent < other else (other, agent)
        diagram = problem.diagrams.get(pair)
        if diagram is not None:
            blocked[: horizon + 1] |= (diagram.T if agent < other else diagram)[positions]
    knots = sorted(problem.knots[agent])
    latest = {position: step for who, position, step in problem.deadlines if who == agent}
    times = np.arange(horizon + 1)
    arrivals = np.zeros((len(knots), horizon + 1), dtype=bool)
    arrivals[0, 0] = not blocked[0, 0]
    arrived = np.zeros((len(knots), horizon + 1), dtype=np.int64)  # when the agent last came, if it may stay
    for n, knot in enumerate(knots):
        if knot in latest:
            arrivals[n, latest[knot] + 1 :] = False
        came = np.maximum.accumulate(np.where(arrivals[n], times, -1))
        barred = np.maximum.accumulate(np.where(blocked[: horizon + 1, knot], times, -1))
        arrived[n] = np.where(came > barred, came, -1)
        if knot == length:
            break
        steps = knots[n + 1] - knot
        row, column = blocked.strides
        ahead = np.lib.stride_tricks.as_strided(  # (t, k): where the agent is k steps after leaving at t
            blocked[1:, knot + 1 :], (horizon + 1, steps), (row, row + column), writeable=False
        )
        leaves = (arrived[n] >= 0) & ~ahead.any(axis=1)
        arrivals[n + 1, steps:] = leaves[: max(horizon + 1 - steps, 0)]
    final = np.flatnonzero(
        (arrived[-1] >= 0) & (times > np.max(times[blocked[: horizon + 1, length]], initial=-1))
    )
    if not len(final):
        return None
    way = np.full(horizon + 1, length)
    time = int(final[0])
    for n in range(len(knots) - 1, -1, -1):
        came = int(arrived[n, time])
        way[came : time + 1] = knots[n]
        if n:
            steps = knots[n] - knots[n - 1]
            way[came - steps : came + 1] = np.arange(knots[n - 1], knots[n] + 1)
            time = came - steps
    return way


def _search(
    problem: Problem, tables: Mapping[Pair, NDArray[np.int32]], weight: float, budget: int, shorter_than: int
) -> tuple[NDArray[np.int64] | None, int, bool]:
    """Weighted A* for a schedule of fewer than `shorter_than` steps: (schedule or None, bound, settled).

    `settled`: None proves that there is none. The bound holds for all schedules below `shorter_than`.
    """
    lengths, knots = problem.lengths, problem.knots
    lookups = [(i, j, table.tolist()) for (i, j), table in tables.items()]

    def to_go(state: tuple[int, ...]) -> int:
        most = max(map(sub, lengths, state))
        for i, j, table in lookups:
            left = table[state[i]][state[j]]
            if left > most:
                most = left
        return most

    start, goal = (0,) * len(lengths), tuple(lengths)
    first = to_go(start)
    parents: dict[tuple[int, ...], tuple[int, ...] | None] = {start: None}
    steps = {start: 0}
    heap = [(weight * first, 0, 0, start)]  # ties: the most progress, then the newest
    closed: set[tuple[int, ...]] = set()
    pushed, bound = 0, first
    while heap:
        key, *_, state = heappop(heap)
        if state in closed:
            continue
        closed.add(state)
        step = steps[state]
        if weight == 1.0:
            bound = int(key)
        if state == goal:
            return _walk(parents, goal), bound, True
        if len(closed) > budget:
            return None, bound, False
        options = []
        for position, length, may_wait in zip(state, lengths, knots, strict=True):
            onward = (position + 1,) if position < length else ()
            options.append((position, *onward) if position in may_wait else onward)
        for following in product(*options):
            if following == state or steps.get(following, UNREACHABLE) <= step + 1:
                continue
            left = to_go(following)
            if step + 1 + left >= shorter_than or _late(problem, following, step + 1):
                continue
            pushed += 1
            steps[following], parents[following] = step + 1, state
            heappush(heap, (step + 1 + weight * left, -sum(following), -pushed, following))
            closed.discard(following)
    return None, bound, True


def _late(problem: Problem, state: tuple[int, ...], step: int) -> bool:
    return any(
        state[agent] < position and step + position - state[agent] > latest
        for agent, position, latest in problem.deadlines
    )


def _walk(
    parents: Mapping[tuple[int, ...], tuple[int, ...] | None], goal: tuple[int, ...]
) -> NDArray[np.int64]:
    states: list[tuple[int, ...]] = []
    state: tuple[int, ...] | None = goal
    while state is not None:
        states.append(state)
        state = parents[state]
    return np.array(states[::-1], dtype=np.int64)


def blocked_region(diagram: Diagram, knots_a: Sequence[int], knots_b: Sequence[int]) -> Pair:
    """How far two agents get together before they are stuck: the reachable state with the largest sum."""
    rows, columns = diagram.shape
    reached = np.zeros_like(diagram)
    waits_a, waits_b = np.isin(np.arange(rows), knots_a), np.isin(np.arange(columns), knots_b)
    farthest = (0, 0)
    for row in range(rows):
        line = np.zeros(columns, dtype=bool)
        if row == 0:
            line[0] = True
        else:
            line[1:] |= reached[row - 1, :-1]
            line |= reached[row - 1] & waits_b
        line &= ~diagram[row]
        if waits_a[row]:
            for column in np.flatnonzero(line[:-1]).tolist():
                onward = column + 1
                while onward < columns and not diagram[row, onward] and not line[onward]:
                    line[onward] = True
                    onward += 1
        reached[row] = line
        ends = np.flatnonzero(line)
        if len(ends) and row + ends[-1] > sum(farthest):
            farthest = (row, int(ends[-1]))
    return farthest
