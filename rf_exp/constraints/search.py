"""The shortest schedule of agents on fixed paths: integers in, integers out.

A joint state holds a path position for each agent. In one control step every agent moves on by one
position or waits, and it waits only at its knots. Forbidden are pairs of positions (coordination
diagrams). Two agents are solved exactly by a dynamic programme over their diagram; its table of
remaining steps is a lower bound for any larger team, and with these bounds A* finds the shortest
schedule of all agents. When A* runs out of its budget, a weighted search finds a good schedule and
the frontier of A* still proves a lower bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

Pair = tuple[int, int]
Diagram = NDArray[np.bool_]  # (P_i, P_j) True = forbidden

UNREACHABLE = np.iinfo(np.int32).max // 4
BUDGET = 60_000  # states that the exact search may expand
WEIGHTS = (1.0, 1.1, 1.5, 4.0)  # of the remaining steps; from exact to greedy


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

    bound = 0
    for weight in WEIGHTS:
        found, lowest, proven = _search(problem, tables, weight, budget)
        bound = max(bound, lowest)
        if found is not None:
            return Found(found, bound)
        if proven:
            return Impossible(None, proven=True)
    return Impossible(None, proven=False)


def _search(
    problem: Problem, tables: Mapping[Pair, NDArray[np.int32]], weight: float, budget: int
) -> tuple[NDArray[np.int64] | None, int, bool]:
    """Weighted A*: (schedule or None, proven lower bound, whether None proves that none exists)."""
    lengths, knots = problem.lengths, problem.knots
    lookups = [(i, j, table.tolist()) for (i, j), table in tables.items()]

    def to_go(state: tuple[int, ...]) -> int:
        most = max(length - position for length, position in zip(lengths, state, strict=True))
        for i, j, table in lookups:
            most = max(most, table[state[i]][state[j]])
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
            bound = max(bound, int(key))
        if state == goal:
            return _walk(parents, goal), bound if weight == 1.0 else first, True
        if len(closed) > budget:
            return None, bound, False
        options = []
        for position, length, may_wait in zip(state, lengths, knots, strict=True):
            onward = (position + 1,) if position < length else ()
            options.append((*onward, position) if position in may_wait else onward)
        for following in product(*options):
            if following == state or steps.get(following, UNREACHABLE) <= step + 1:
                continue
            left = to_go(following)
            if left >= UNREACHABLE or _late(problem, following, step + 1):
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
