"""Exact search for the shortest schedule of agents on fixed paths, in integers only.

In one control step every agent advances by one position of its path or waits, and it waits only at its
knots. So a schedule is given by the start step of each segment between two knots, and a forbidden pair of
positions (coordination diagrams) is a choice: one agent has passed before the other one comes, or vice
versa. Each alternative is a bound on the difference of two starts. Bounds are closed under addition (longest
paths), a choice with one alternative left becomes a bound, and open choices are branched on. A refuted
makespan raises the proven bound, a feasible one is a schedule: bisection ends with the shortest schedule
(Brucker, Jurisch and Sievers 1994, A branch and bound algorithm for the job-shop scheduling problem, is the
same idea for machines). Coordination diagrams: O'Donnell and Lozano-Perez 1989, Deadlock-free and
collision-free coordination of two robot manipulators.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise, product

import numpy as np
from numpy.typing import NDArray

Pair = tuple[int, int]
Diagram = NDArray[np.bool_]  # (P_i, P_j) True = forbidden
Bound = tuple[int, int, int]  # x, y, c: start x is at least c steps after start y
Choice = tuple[Bound, Bound]  # one of the two holds

BUDGET = 1_000  # choices that may be branched on, for each makespan
UNREACHABLE = np.iinfo(np.int32).max // 4  # steps
UNBOUNDED = -(10**7)  # steps: less than any difference of two starts
NEVER: Bound = (0, 0, 1)


@dataclass(frozen=True)
class Problem:
    """Scheduling problem. Agents from 0. `diagrams` has an entry (i, j), i < j, for all but free pairs."""

    knots: tuple[frozenset[int], ...]  # positions at which an agent may wait; 0 and the last one included
    lengths: tuple[int, ...]  # last position of each agent
    diagrams: Mapping[Pair, Diagram]
    deadlines: tuple[tuple[int, int, int], ...] = ()  # (agent, position, latest step)
    apart: Mapping[Pair, Diagram] = field(default_factory=dict)  # also forbidden, and passed `slack` apart
    slack: int = 0  # steps by which either of two agents may be late without meeting the other in `apart`


@dataclass(frozen=True)
class Found:
    """A schedule with its proven bound."""

    positions: NDArray[np.int64]  # (T + 1, N)
    bound: int  # no schedule has fewer steps


@dataclass(frozen=True)
class Impossible:
    """No schedule exists (`pair` alone is the reason if given), or none was found within the budget."""

    pair: Pair | None
    proven: bool


def solve(problem: Problem, budget: int = BUDGET) -> Found | Impossible:
    """The shortest schedule, or the best one found within the budget with its proven bound."""
    starts = _Starts(problem)
    # At least one agent moves in every step, except in the slack before a segment.
    longest = sum(problem.lengths) + problem.slack * sum(map(len, problem.knots))
    steps, settled = starts.within(longest, budget)
    if steps is None:
        for i, j in combinations(range(len(problem.lengths)), 2):
            diagram, knots = problem.diagrams.get((i, j)), (problem.knots[i], problem.knots[j])
            if diagram is not None and remaining(diagram, *knots)[0, 0] >= UNREACHABLE:
                return Impossible((i, j), proven=True)
        return Impossible(None, proven=settled)
    bound = max(problem.lengths)
    makespan = beyond = starts.makespan(steps)
    while bound < beyond:
        middle = (bound + beyond - 1) // 2
        shorter, settled = starts.within(middle, budget)
        if shorter is not None:
            steps = shorter
            makespan = beyond = starts.makespan(steps)
        elif settled:
            bound = middle + 1
        else:
            beyond = middle
    return Found(starts.positions(steps, makespan), bound)


class _Paths:
    """The segments of all agents, numbered from 1; 0 stands for the beginning of the schedule."""

    def __init__(self, problem: Problem) -> None:
        self.knots = [sorted(knots) for knots in problem.knots]
        first = np.cumsum([1, *(len(knots) - 1 for knots in self.knots)]).tolist()
        self.segments = [list(range(low, high)) for low, high in pairwise(first)]  # of each agent
        self.parts = [  # of each agent: a segment, and the knots between which it runs
            [(segment, *knots) for segment, knots in zip(segments, pairwise(ends), strict=True)]
            for segments, ends in zip(self.segments, self.knots, strict=True)
        ]
        self.count = first[-1]

    def arrives(self, agent: int, knot: int) -> tuple[int, int]:
        """Segment and steps after its start at which an agent arrives at a knot."""
        if knot == 0:
            return 0, 0
        return self.segments[agent][knot - 1], self.knots[agent][knot] - self.knots[agent][knot - 1]

    def leaves_before(self, agent: int, knot: int, segment: int, step: int) -> Bound:
        """Bound: the agent leaves a knot before a segment has reached a step."""
        if knot == len(self.knots[agent]) - 1:
            return NEVER
        return segment, self.segments[agent][knot], 1 - step

    def choices(self, diagrams: Mapping[Pair, Diagram]) -> Iterator[Choice]:
        """The choices that the diagrams imply."""
        for (i, j), diagram in diagrams.items():
            if diagram.any():
                yield from self._passing(i, j, diagram)
                yield from self._standing(i, j, diagram)
                yield from self._standing(j, i, diagram.T)
                yield from self._resting(i, j, diagram)

    def _passing(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where both agents move."""
        for (x, low, high), (y, left, right) in product(self.parts[i], self.parts[j]):
            rows, columns = np.nonzero(diagram[low : high + 1, left : right + 1])
            ahead = np.zeros(high - low + right - left + 1, dtype=bool)
            ahead[rows - columns + right - left] = True
            for begin, end in _runs(ahead):  # forbidden: begin <= y - x + right - left < end, of starts
                yield (y, x, end - right + left), (x, y, right - left - begin + 1)

    def _standing(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where agent i moves and agent j waits at a knot."""
        for knot, position in enumerate(self.knots[j]):
            segment, steps = self.arrives(j, knot)
            for x, low, high in self.parts[i]:
                for begin, end in _runs(diagram[low : high + 1, position]):
                    yield self.leaves_before(j, knot, x, begin), (segment, x, end - steps)

    def _resting(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where both agents wait at knots."""
        for a, b in np.argwhere(diagram[np.ix_(self.knots[i], self.knots[j])]).tolist():
            yield self.leaves_before(i, a, *self.arrives(j, b)), self.leaves_before(j, b, *self.arrives(i, a))


class _Starts:
    """Start steps of all segments: bounds on their differences, and choices between bounds."""

    def __init__(self, problem: Problem) -> None:
        self._paths = paths = _Paths(problem)
        choices, apart = (
            np.array(list(paths.choices(diagrams)), dtype=np.int64).reshape(-1, 2, 3)
            for diagrams in (problem.diagrams, problem.apart)
        )
        choices = np.concatenate([choices, apart + np.array([0, 0, problem.slack])])
        self._x, self._y, self._c = choices[..., 0], choices[..., 1], choices[..., 2]  # (K, 2) each
        # (S, S): start of the column less start of the row is at least this
        self._least = np.full((paths.count, paths.count), UNBOUNDED)
        self._least[0] = 0
        np.fill_diagonal(self._least, 0)
        for knots, segments in zip(paths.knots, paths.segments, strict=True):
            for x, y, steps in zip(segments, segments[1:], np.diff(knots).tolist(), strict=False):
                self._least[x, y] = steps
        for agent, position, latest in problem.deadlines:
            if position > 0:
                knot = int(np.searchsorted(paths.knots[agent], position)) - 1
                segment, step = paths.segments[agent][knot], latest - position + paths.knots[agent][knot]
                self._least[segment, 0] = max(self._least[segment, 0], -step)
        self._open = _closed(self._least) and self._forced(self._least)
        # Last segment of each agent that moves, and its steps.
        self._ends = [(parts[-1][0], parts[-1][2] - parts[-1][1]) for parts in paths.parts if parts]

    def makespan(self, starts: NDArray[np.int64]) -> int:
        return max((int(starts[segment]) + steps for segment, steps in self._ends), default=0)

    def positions(self, starts: NDArray[np.int64], makespan: int) -> NDArray[np.int64]:
        """(makespan + 1, N) path position of each agent."""
        times, paths = np.arange(makespan + 1)[:, None], self._paths
        agents = zip(paths.knots, paths.segments, strict=True)
        columns = [np.clip(times - starts[own], 0, np.diff(knots)).sum(axis=1) for knots, own in agents]
        return np.stack(columns, axis=1)

    def within(self, makespan: int, budget: int) -> tuple[NDArray[np.int64] | None, bool]:
        """The earliest starts (S,) of a schedule within `makespan` steps, and whether the answer is settled.

        A settled None proves that there is none.
        """
        least = self._least.copy()
        in_time = all(_bounded(least, 0, segment, steps - makespan) for segment, steps in self._ends)
        todo = [least] if self._open and in_time and self._forced(least) else []
        while todo:
            least = todo.pop()
            starts = least[0]
            lack = self._c - (starts[self._x] - starts[self._y])  # (K, 2) violation of each alternative
            missed = lack.min(axis=1, initial=UNREACHABLE)
            if not (missed > 0).any():
                return starts, True
            if budget <= 0:
                return None, False
            budget -= 1
            worst = int(missed.argmax())
            for way in np.argsort(-lack[worst], kind="stable").tolist():  # the less violated one first
                tried = least.copy()
                if self._chosen(tried, worst, way) and self._forced(tried):
                    todo.append(tried)
        return None, True

    def _forced(self, least: NDArray[np.int64]) -> bool:
        """Turns every choice with one alternative left into a bound; False if one has none left."""
        while True:
            closed = least[self._x, self._y] + self._c > 0  # (K, 2) alternatives that are excluded
            if closed.all(axis=1).any():
                return False
            choice, way = np.nonzero(closed[:, ::-1] & (least[self._y, self._x] < self._c))
            if not len(choice):
                return True
            if 2 * len(choice) < len(least):  # cheaper one by one
                for one in zip(choice.tolist(), way.tolist(), strict=True):
                    if not self._chosen(least, *one):
                        return False
                continue
            pairs = self._y[choice, way], self._x[choice, way]
            np.maximum.at(least, pairs, self._c[choice, way])
            if not _closed(least):
                return False

    def _chosen(self, least: NDArray[np.int64], choice: int, way: int) -> bool:
        return _bounded(least, self._x[choice, way], self._y[choice, way], self._c[choice, way])


def _bounded(least: NDArray[np.int64], x: int, y: int, c: int) -> bool:
    """Adds a bound to closed ones; False if it contradicts them."""
    if least[y, x] < c:
        np.maximum(least, (least[:, y] + c)[:, None] + least[x], out=least)
    return not least.diagonal().any()


def _closed(least: NDArray[np.int64]) -> bool:
    """Closes bounds under addition (Floyd and Warshall); False if they contradict one another."""
    for middle in range(len(least)):
        np.maximum(least, least[:, middle, None] + least[middle], out=least)
    return not least.diagonal().any()


def _runs(mask: NDArray[np.bool_]) -> list[Pair]:
    """First index and index after the last one of every run of True."""
    edges = (np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist()
    edges = [*([0] if mask[0] else []), *edges, *([len(mask)] if mask[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def remaining(diagram: Diagram, knots_a: frozenset[int], knots_b: frozenset[int]) -> NDArray[np.int32]:
    """(P, Q) fewest steps from each pair of positions to both ends; UNREACHABLE where none lead there.

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
        if row in knots_a:  # this agent may wait here while the other one moves
            start = 0
            for stop in [*np.flatnonzero(diagram[row]).tolist(), columns]:
                run = slice(start, stop)
                ahead = (best[run] + offsets[run])[::-1]
                best[run] = np.minimum.accumulate(ahead)[::-1] - offsets[run]
                start = stop + 1
        steps[row, :-1] = np.minimum(best, UNREACHABLE)
    return steps[:-1, :-1]


def blocked_region(diagram: Diagram, knots_a: Sequence[int], knots_b: Sequence[int]) -> Pair:
    """How far two agents get together before they are stuck: the reachable state with the largest sum."""
    rows, columns = diagram.shape
    waits_a, waits_b = np.isin(np.arange(rows), knots_a), np.isin(np.arange(columns), knots_b)
    reached = np.zeros((rows + 1, columns + 1), dtype=bool)  # a row and a column before the first
    reached[0, 0] = True
    farthest = (0, 0)
    for row, free in enumerate(~diagram):
        line = (reached[row, :-1] | reached[row, 1:] & waits_b) & free
        if waits_a[row]:
            for column in range(1, columns):
                line[column] |= line[column - 1] & free[column]
        reached[row + 1, 1:] = line
        ends = np.flatnonzero(line)
        if len(ends) and row + ends[-1] > sum(farthest):
            farthest = (row, int(ends[-1]))
    return farthest
