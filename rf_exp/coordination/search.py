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
IMPOSSIBLE_BOUND: Bound = (0, 0, 1)


@dataclass(frozen=True)
class Problem:
    """Scheduling problem. Agents from 0. `diagrams` has an entry (i, j), i < j, for all but free pairs."""

    knots: tuple[frozenset[int], ...]  # positions at which an agent may wait; 0 and the last one included
    lengths: tuple[int, ...]  # last position of each agent
    diagrams: Mapping[Pair, Diagram]
    deadlines: tuple[tuple[int, int, int], ...] = ()  # (agent, position, latest step)
    slack_diagrams: Mapping[Pair, Diagram] = field(default_factory=dict)  # forbidden too, even `slack` late
    slack: int = 0  # steps by which either of two agents may be late without entering `slack_diagrams`


@dataclass(frozen=True)
class Solution:
    """A schedule with its proven bound."""

    positions: NDArray[np.int64]  # (T + 1, N)
    bound: int  # no schedule has fewer steps


@dataclass(frozen=True)
class Infeasible:
    """No schedule exists (`pair` alone is the reason if given), or none was found within the budget."""

    pair: Pair | None
    proven: bool


def solve(problem: Problem, budget: int = BUDGET) -> Solution | Infeasible:
    """The shortest schedule, or the best one found within the budget with its proven bound."""
    starts = _StartBounds(problem)
    # At least one agent moves in every step, except in the slack before a segment.
    longest = sum(problem.lengths) + problem.slack * sum(map(len, problem.knots))
    steps, settled = starts.starts_within(longest, budget)
    if steps is None:
        for i, j in combinations(range(len(problem.lengths)), 2):
            diagram, knots = problem.diagrams.get((i, j)), (problem.knots[i], problem.knots[j])
            if diagram is not None and steps_to_go(diagram, *knots)[0, 0] >= UNREACHABLE:
                return Infeasible((i, j), proven=True)
        return Infeasible(None, proven=settled)
    lower = max(problem.lengths)
    makespan = upper = starts.makespan(steps)
    while lower < upper:
        trial = (lower + upper - 1) // 2
        shorter, settled = starts.starts_within(trial, budget)
        if shorter is not None:
            steps = shorter
            makespan = upper = starts.makespan(steps)
        elif settled:
            lower = trial + 1
        else:
            upper = trial
    return Solution(starts.positions(steps, makespan), lower)


class _SegmentTable:
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
            return IMPOSSIBLE_BOUND
        return segment, self.segments[agent][knot], 1 - step

    def choices(self, diagrams: Mapping[Pair, Diagram]) -> Iterator[Choice]:
        """The choices that the diagrams imply."""
        for (i, j), diagram in diagrams.items():
            if diagram.any():
                yield from self._moving_choices(i, j, diagram)
                yield from self._waiting_choices(i, j, diagram)
                yield from self._waiting_choices(j, i, diagram.T)
                yield from self._both_waiting_choices(i, j, diagram)

    def _moving_choices(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where both agents move."""
        for (x, low, high), (y, left, right) in product(self.parts[i], self.parts[j]):
            rows, columns = np.nonzero(diagram[low : high + 1, left : right + 1])
            ahead = np.zeros(high - low + right - left + 1, dtype=bool)
            ahead[rows - columns + right - left] = True
            for begin, end in _runs(ahead):  # forbidden: begin <= y - x + right - left < end, of starts
                yield (y, x, end - right + left), (x, y, right - left - begin + 1)

    def _waiting_choices(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where agent i moves and agent j waits at a knot."""
        for knot, position in enumerate(self.knots[j]):
            segment, steps = self.arrives(j, knot)
            for x, low, high in self.parts[i]:
                for begin, end in _runs(diagram[low : high + 1, position]):
                    yield self.leaves_before(j, knot, x, begin), (segment, x, end - steps)

    def _both_waiting_choices(self, i: int, j: int, diagram: Diagram) -> Iterator[Choice]:
        """Choices where both agents wait at knots."""
        for a, b in np.argwhere(diagram[np.ix_(self.knots[i], self.knots[j])]).tolist():
            yield self.leaves_before(i, a, *self.arrives(j, b)), self.leaves_before(j, b, *self.arrives(i, a))


class _StartBounds:
    """Start steps of all segments: bounds on their differences, and choices between bounds."""

    def __init__(self, problem: Problem) -> None:
        self._paths = paths = _SegmentTable(problem)
        choices, slack_diagrams = (
            np.array(list(paths.choices(diagrams)), dtype=np.int64).reshape(-1, 2, 3)
            for diagrams in (problem.diagrams, problem.slack_diagrams)
        )
        choices = np.concatenate([choices, slack_diagrams + np.array([0, 0, problem.slack])])
        self._x, self._y, self._c = choices[..., 0], choices[..., 1], choices[..., 2]  # (K, 2) each
        # (S, S): start of the column less start of the row is at least this
        self._min_offsets = np.full((paths.count, paths.count), UNBOUNDED)
        self._min_offsets[0] = 0
        np.fill_diagonal(self._min_offsets, 0)
        for knots, segments in zip(paths.knots, paths.segments, strict=True):
            for x, y, steps in zip(segments, segments[1:], np.diff(knots).tolist(), strict=False):
                self._min_offsets[x, y] = steps
        for agent, position, latest in problem.deadlines:
            if position > 0:
                knot = int(np.searchsorted(paths.knots[agent], position)) - 1
                segment, step = paths.segments[agent][knot], latest - position + paths.knots[agent][knot]
                self._min_offsets[segment, 0] = max(self._min_offsets[segment, 0], -step)
        self._feasible = _close(self._min_offsets) and self._propagate(self._min_offsets)
        # Last segment of each agent that moves, and its steps.
        self._ends = [(parts[-1][0], parts[-1][2] - parts[-1][1]) for parts in paths.parts if parts]

    def makespan(self, starts: NDArray[np.int64]) -> int:
        return max((int(starts[segment]) + steps for segment, steps in self._ends), default=0)

    def positions(self, starts: NDArray[np.int64], makespan: int) -> NDArray[np.int64]:
        """(makespan + 1, N) path position of each agent."""
        times, paths = np.arange(makespan + 1)[:, None], self._paths
        agents = zip(paths.knots, paths.segments, strict=True)
        columns = [
            np.clip(times - starts[segments], 0, np.diff(knots)).sum(axis=1) for knots, segments in agents
        ]
        return np.stack(columns, axis=1)

    def starts_within(self, makespan: int, budget: int) -> tuple[NDArray[np.int64] | None, bool]:
        """The earliest starts (S,) of a schedule within `makespan` steps, and whether the answer is settled.

        A settled None proves that there is none.
        """
        offsets = self._min_offsets.copy()
        deadlines_hold = all(
            _add_bound(offsets, 0, segment, steps - makespan) for segment, steps in self._ends
        )
        stack = [offsets] if self._feasible and deadlines_hold and self._propagate(offsets) else []
        while stack:
            offsets = stack.pop()
            starts = offsets[0]
            shortfall = self._c - (starts[self._x] - starts[self._y])  # (K, 2) shortfall of each alternative
            min_shortfall = shortfall.min(axis=1, initial=UNREACHABLE)
            if not (min_shortfall > 0).any():
                return starts, True
            if budget <= 0:
                return None, False
            budget -= 1
            worst = int(min_shortfall.argmax())
            # The less violated one is pushed last, so it is tried first.
            for alternative in np.argsort(-shortfall[worst], kind="stable").tolist():
                branch = offsets.copy()
                if self._apply_choice(branch, worst, alternative) and self._propagate(branch):
                    stack.append(branch)
        return None, True

    def _propagate(self, offsets: NDArray[np.int64]) -> bool:
        """Turns every choice with one alternative left into a bound; False if one has none left."""
        while True:
            excluded = offsets[self._x, self._y] + self._c > 0  # (K, 2) alternatives that are excluded
            if excluded.all(axis=1).any():
                return False
            choice, alternative = np.nonzero(excluded[:, ::-1] & (offsets[self._y, self._x] < self._c))
            if not len(choice):
                return True
            if 2 * len(choice) < len(offsets):  # cheaper one by one
                for pair in zip(choice.tolist(), alternative.tolist(), strict=True):
                    if not self._apply_choice(offsets, *pair):
                        return False
                continue
            pairs = self._y[choice, alternative], self._x[choice, alternative]
            np.maximum.at(offsets, pairs, self._c[choice, alternative])
            if not _close(offsets):
                return False

    def _apply_choice(self, offsets: NDArray[np.int64], choice: int, alternative: int) -> bool:
        return _add_bound(
            offsets,
            self._x[choice, alternative],
            self._y[choice, alternative],
            self._c[choice, alternative],
        )


def _add_bound(offsets: NDArray[np.int64], x: int, y: int, c: int) -> bool:
    """Adds a bound to closed ones; False if it contradicts them."""
    if offsets[y, x] < c:
        np.maximum(offsets, (offsets[:, y] + c)[:, None] + offsets[x], out=offsets)
    return not offsets.diagonal().any()


def _close(offsets: NDArray[np.int64]) -> bool:
    """Closes bounds under addition (Floyd and Warshall); False if they contradict one another."""
    for middle in range(len(offsets)):
        np.maximum(offsets, offsets[:, middle, None] + offsets[middle], out=offsets)
    return not offsets.diagonal().any()


def _runs(mask: NDArray[np.bool_]) -> list[Pair]:
    """First index and index after the last one of every run of True."""
    edges = (np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist()
    edges = [*([0] if mask[0] else []), *edges, *([len(mask)] if mask[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def steps_to_go(diagram: Diagram, knots_a: frozenset[int], knots_b: frozenset[int]) -> NDArray[np.int32]:
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
            run_start = 0
            for run_stop in [*np.flatnonzero(diagram[row]).tolist(), columns]:
                run = slice(run_start, run_stop)
                ahead = (best[run] + offsets[run])[::-1]
                best[run] = np.minimum.accumulate(ahead)[::-1] - offsets[run]
                run_start = run_stop + 1
        steps[row, :-1] = np.minimum(best, UNREACHABLE)
    return steps[:-1, :-1]


def farthest_reachable(diagram: Diagram, knots_a: Sequence[int], knots_b: Sequence[int]) -> Pair:
    """How far two agents get together before they are stuck: the reachable state with the largest sum."""
    rows, columns = diagram.shape
    waits_a, waits_b = np.isin(np.arange(rows), knots_a), np.isin(np.arange(columns), knots_b)
    reached = np.zeros((rows + 1, columns + 1), dtype=bool)  # a row and a column before the first
    reached[0, 0] = True
    farthest = (0, 0)
    for row, free in enumerate(~diagram):
        reachable = (reached[row, :-1] | reached[row, 1:] & waits_b) & free
        if waits_a[row]:
            for column in range(1, columns):
                reachable[column] |= reachable[column - 1] & free[column]
        reached[row + 1, 1:] = reachable
        ends = np.flatnonzero(reachable)
        if len(ends) and row + ends[-1] > sum(farthest):
            farthest = (row, int(ends[-1]))
    return farthest
