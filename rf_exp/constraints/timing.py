"""From rest-to-rest trajectories to a schedule: who is where at which control step.

All constraints on time become cells of coordination diagrams (`Demands`), which one exact search
serves (`search.solve`). Agents wait only at knots, where they stand still anyway, so the motion of
a schedule has the accelerations of its trajectories.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import search
from rf_exp.constraints.unscheduled import Unscheduled
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.geometry import Mask
from rf_exp.statements import Proposal
from rf_exp.types import Schedule, Segment, Subgoal, Trajectory


class Rule(Protocol):
    """A constraint on time that knows what it asks of a schedule."""

    def demand(self, demands: "Demands") -> None:
        """Add what this constraint forbids."""
        ...


class Demands:
    """What the rules ask of a schedule of trajectories. Agents from 1; positions on their paths."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        self.trajectories = tuple(trajectories)
        self.cells: dict[tuple[int, int], Mask] = {}
        self.dwells: dict[tuple[int, int], int] = {}  # (agent, position) -> steps to stay there
        self.after_dwell: list[tuple[int, int, int, int, bool]] = []
        self.deadlines: list[tuple[int, int, int]] = []

    def trajectory(self, agent: int) -> Trajectory:
        return self.trajectories[agent - 1]

    def forbid(self, a: int, rows: slice, b: int, columns: slice) -> None:
        """Agents a and b may not be at these positions at the same time."""
        i, j = sorted((a, b))
        mask = self.cells.setdefault(
            (i, j), np.zeros((len(self.trajectory(i)) + 1, len(self.trajectory(j)) + 1), dtype=bool)
        )
        (mask if a < b else mask.T)[rows, columns] = True

    def apart(self, i: int, j: int, mask: Mask) -> None:
        """Agents i < j may not be at the pairs of positions (P_i, P_j) of a mask at the same time."""
        self.cells[i, j] = mask | self.cells.get((i, j), np.zeros_like(mask))

    def before(self, a: int, end: int, b: int, start: int) -> None:
        """b leaves position `start` only once a has reached `end`."""
        self.forbid(a, slice(0, end), b, slice(start + 1, None))

    def together(self, a: int, start_a: int, b: int, start_b: int, within_steps: int) -> None:
        """a and b leave their positions at most `within_steps` apart.

        Counted in positions, so the bound is cut to the length of the first segments: there nobody waits.
        """
        for first, start, other, other_start in ((a, start_a, b, start_b), (b, start_b, a, start_a)):
            knots = self.trajectory(first).knots
            run = min((knot for knot in knots if knot > start), default=start + 1) - start
            apart = max(0, min(within_steps, run - 1))
            self.forbid(first, slice(start + apart + 1, None), other, slice(0, other_start + 1))

    def lockstep(self, a: int, start_a: int, b: int, start_b: int, steps: int) -> None:
        """a and b run `steps` positions side by side, never one ahead of the other."""
        i, j = sorted((a, b))
        start = {a: start_a, b: start_b}
        done_i, done_j = (
            np.clip(np.arange(len(self.trajectory(agent)) + 1) - start[agent], 0, steps) for agent in (i, j)
        )
        self.forbid(i, slice(0), j, slice(0))
        self.cells[i, j] |= done_i[:, None] != done_j[None, :]

    def delay(self, a: int, end: int, b: int, start: int, steps: int) -> None:
        """b leaves `start` at the earliest `steps` after a has reached `end`.

        The time is spent as a dwell: of a, where its path ends there anyway, otherwise of b.
        """
        at_end = end == len(self.trajectory(a))
        agent, position = (a, end) if at_end else (b, start)
        self.dwells[agent, position] = max(steps, self.dwells.get((agent, position), 0))
        self.after_dwell.append((a, end, b, start, at_end))

    def deadline(self, agent: int, position: int, steps: int) -> None:
        """The agent reaches a position at the latest after `steps`."""
        self.deadlines.append((agent, position, steps))


@dataclass(frozen=True)
class Delays:
    """How much a schedule forgives, and how much later than the shortest it is on purpose."""

    slack_steps: int  # by which any one agent may be late without meeting another
    pauses: Mapping[tuple[int, int], int]  # (agent, knot) -> steps it stays there at least


def joint_runs(trajectories: Sequence[Trajectory]) -> list[tuple[str, list[tuple[int, int, int]]]]:
    """Label of joined segments -> (agent, first position, length) of each agent that has it."""
    found: dict[str, list[tuple[int, int, int]]] = {}
    for trajectory in trajectories:
        for label, start, length in _labelled(trajectory):
            found.setdefault(label, []).append((trajectory.agent, start, length))
    return sorted(found.items())


def _labelled(trajectory: Trajectory) -> Iterable[tuple[str, int, int]]:
    start = 0
    for label, run in groupby(trajectory.segments, key=lambda segment: segment.joined):
        length = sum(map(len, run))
        if label is not None:
            yield label, start, length
        start += length


def schedule(
    trajectories: Sequence[Trajectory],
    diagrams: Mapping[tuple[int, int], Mask] | None = None,
    rules: Sequence[Rule] = (),
    delays: Delays | None = None,
    *,
    begins_s: float = 0.0,
    budget: int = search.BUDGET,
) -> Schedule | Violation:
    """The shortest schedule of all agents that obeys diagrams, rules and joined segments, with `delays`.

    `diagrams[i, j]` (i < j, agents from 1) forbids pairs of path positions. The schedule begins at
    `begins_s`, in seconds since the start of the episode. Where none exists, a Violation says which pair
    cannot pass each other, or what else is in the way. Raises ArgumentError for trajectories that are not
    those of agents 1 to N, or for diagrams of another shape.
    """
    _agents(trajectories)
    diagrams = diagrams or {}
    _shapes(trajectories, diagrams)
    demands, unscheduled = Demands(trajectories), Unscheduled(trajectories, diagrams, begins_s)
    for rule in rules:
        rule.demand(demands)
    for label, runs in joint_runs(trajectories):
        for (a, start_a, length_a), (b, start_b, length_b) in combinations(runs, 2):
            if length_a != length_b:
                return unscheduled.unequal(a, b, label, abs(length_a - length_b))
            demands.lockstep(a, start_a, b, start_b, length_a)
    asked = {*demands.dwells}
    apart: dict[tuple[int, int], Mask] = {}
    if delays is not None:
        apart = {pair: diagram & ~_joined(demands, pair) for pair, diagram in diagrams.items()}
        for key, steps in delays.pauses.items():
            demands.dwells[key] = max(steps, demands.dwells.get(key, 0))
    hard = {pair: diagram & ~apart[pair] if pair in apart else diagram for pair, diagram in diagrams.items()}
    problem, real = _problem(demands, hard, apart, delays.slack_steps if delays is not None else 0)
    answer = search.solve(problem, budget)
    if isinstance(answer, search.Impossible):
        return unscheduled.why(answer, problem, real)
    columns = [real[k][answer.positions[:, k]] for k in range(len(trajectories))]
    found = Schedule(np.stack(columns, axis=1), answer.bound)
    if delays is None:
        return found
    return replace(found, hesitates=_hesitates(found.positions, demands, diagrams, asked, delays.slack_steps))


def _joined(demands: Demands, pair: tuple[int, int]) -> Mask:
    """Positions at which two agents carry one thing: neither can be late alone."""
    i, j = pair
    found = np.zeros((len(demands.trajectory(i)) + 1, len(demands.trajectory(j)) + 1), dtype=bool)
    for _, runs in joint_runs(demands.trajectories):
        of = {agent: slice(start, start + length + 1) for agent, start, length in runs}
        if i in of and j in of:
            found[of[i], of[j]] = True
    return found


def _hesitates(
    positions: NDArray[np.int64],
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    asked: Collection[tuple[int, int]],
    slack: int,
) -> NDArray[np.bool_]:
    """(T + 1, N) who stays though it could go on, but for dwells that were asked for."""
    forbidden = dict(diagrams)
    for pair, cells in demands.cells.items():
        forbidden[pair] = forbidden[pair] | cells if pair in forbidden else cells
    found = np.zeros(positions.shape, dtype=bool)
    for trajectory in demands.trajectories:
        k = trajectory.agent - 1
        for start, end in _stays(positions[:, k], len(trajectory)):
            if (trajectory.agent, int(positions[start, k])) not in asked:
                first = _free_from(positions, k, start, end, trajectory.knots, forbidden, slack)
                found[first + 1 : end + 1, k] = True
    return found


def _stays(positions: NDArray[np.int64], last: int) -> Iterable[tuple[int, int]]:
    """(first, last step) of each stay of an agent, but for that at the end of its path."""
    arrived = np.flatnonzero(np.diff(positions, prepend=-1))
    left = [*(arrived[1:] - 1), len(positions) - 1]
    for start, end in zip(arrived.tolist(), left, strict=True):
        if end > start and positions[start] < last:
            yield start, end


def _free_from(
    positions: NDArray[np.int64],
    k: int,
    start: int,
    end: int,
    knots: Sequence[int],
    forbidden: Mapping[tuple[int, int], Mask],
    slack: int,
) -> int:
    """The first step of a stay (start, end) from which on agent k + 1 could have gone on to its next knot.

    As the others are then, and up to `slack` steps earlier or later. It waits at that knot until the schedule
    has it there.
    """
    knot = min(each for each in knots if each > positions[start, k])
    until = int(np.searchsorted(positions[:, k], knot))  # the step at which the schedule has it there
    for leaves in range(end - 1, start - 1, -1):
        steps = np.arange(leaves, until + 1)
        own = np.minimum(positions[start, k] + steps - leaves, knot)
        for (i, j), mask in forbidden.items():
            if k + 1 not in (i, j):
                continue
            cells, other = (mask, j) if i == k + 1 else (mask.T, i)
            for late in range(-slack, slack + 1):
                there = positions[np.clip(steps + late, 0, len(positions) - 1), other - 1]
                if cells[own, there].any():
                    return leaves + 1
    return start


def _problem(
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    apart: Mapping[tuple[int, int], Mask],
    slack: int,
) -> tuple[search.Problem, tuple[NDArray[np.int64], ...]]:
    """The search problem, in which dwells are extra positions, and the real position of each of them."""
    real: list[NDArray[np.int64]] = []
    knots: list[frozenset[int]] = []
    for trajectory in demands.trajectories:
        repeats = np.ones(len(trajectory) + 1, dtype=int)
        for (agent, position), steps in demands.dwells.items():
            if agent == trajectory.agent:
                repeats[position] += steps
        last = np.cumsum(repeats) - 1  # where each real position is left
        first = last - repeats + 1
        real.append(np.repeat(np.arange(len(repeats)), repeats))
        knots.append(frozenset(int(at) for knot in trajectory.knots for at in (first[knot], last[knot])))
    forbidden: dict[tuple[int, int], Mask] = {}
    for i, j in {*diagrams, *demands.cells}:
        rows, columns = real[i - 1], real[j - 1]
        mask = np.zeros((len(rows), len(columns)), dtype=bool)
        for source in (diagrams, demands.cells):
            if (i, j) in source:
                mask |= source[i, j][rows][:, columns]
        forbidden[i - 1, j - 1] = mask
    for a, end, b, start, at_end in demands.after_dwell:
        i, j = sorted((a, b))
        shape = len(real[i - 1]), len(real[j - 1])
        mask = forbidden.setdefault((i - 1, j - 1), np.zeros(shape, dtype=bool))
        side = "right" if at_end else "left"
        until = int(np.searchsorted(real[a - 1], end, side)) - at_end
        begin = int(np.searchsorted(real[b - 1], start, "right" if at_end else "left")) - at_end
        (mask if a < b else mask.T)[:until, begin + 1 :] = True
    deadlines = tuple(
        (agent - 1, int(np.searchsorted(real[agent - 1], position)), steps)
        for agent, position, steps in demands.deadlines
    )
    lengths = tuple(len(each) - 1 for each in real)
    passed = {(i - 1, j - 1): mask[real[i - 1]][:, real[j - 1]] for (i, j), mask in apart.items()}
    return search.Problem(tuple(knots), lengths, forbidden, deadlines, passed, slack), tuple(real)


def serial(trajectories: Sequence[Trajectory], proposal: Proposal) -> Schedule:
    """Agents take turns, subgoal by subgoal in the order of the plan: a schedule without a model of time."""
    _agents(trajectories)
    # Who moves without being named in the plan makes room for those who are: that comes first.
    turns = [(each.agent, len(each)) for each in trajectories if not proposal.of(each.agent)]  # agent, steps
    waiting = {each.agent: subgoal_runs(each) for each in trajectories if proposal.of(each.agent)}
    for subgoal in proposal.subgoals:
        runs = waiting.get(subgoal.agent, [])
        if runs and runs[0][0] == subgoal:
            turns.append((subgoal.agent, len_of(runs.pop(0)[1])))
        while runs and runs[0][0] not in proposal.subgoals:  # what the planner has added belongs to it
            turns.append((subgoal.agent, len_of(runs.pop(0)[1])))
    for agent, runs in waiting.items():  # what the plan does not name comes last
        turns += [(agent, len_of(segments)) for _, segments in runs]
    position = np.zeros(len(trajectories), dtype=np.int64)
    rows = [position.copy()]
    for agent, steps in turns:
        for _ in range(steps):
            position[agent - 1] += 1
            rows.append(position.copy())
    return Schedule(np.array(rows), max(map(len, trajectories)))


def subgoal_runs(trajectory: Trajectory) -> list[tuple[Subgoal, list[Segment]]]:
    """The segments of each subgoal, in order."""
    return [
        (goal, list(run)) for goal, run in groupby(trajectory.segments, key=lambda segment: segment.subgoal)
    ]


def len_of(segments: Iterable[Segment]) -> int:
    """Control steps of some segments."""
    return sum(map(len, segments))


def actions(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, 8) joint targets rad and gripper command: the action of step t leads to row t + 1."""
    _agents(trajectories)
    paths = [trajectory.path() for trajectory in trajectories]
    return np.stack([path[timed.positions[1:, k]] for k, path in enumerate(paths)], axis=1)


def intended(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, 8) as `actions`, but an agent that hesitates means to go on."""
    found = actions(trajectories, timed)
    if timed.hesitates is not None:
        for k, trajectory in enumerate(trajectories):
            hesitates = timed.hesitates[1:, k]
            found[hesitates, k] = trajectory.path()[timed.positions[1:, k][hesitates] + 1]
    return found


def _agents(trajectories: Sequence[Trajectory]) -> None:
    found = [trajectory.agent for trajectory in trajectories]
    if found != list(range(1, len(found) + 1)):
        raise ArgumentError(
            f"trajectories are of agents {found}; expected one for each agent 1 to N, in order"
        )


def _shapes(trajectories: Sequence[Trajectory], diagrams: Mapping[tuple[int, int], Mask]) -> None:
    for (i, j), diagram in diagrams.items():
        if not 1 <= i < j <= len(trajectories):
            raise ArgumentError(
                f"diagram of agents {(i, j)}; expected i < j of agents 1 to {len(trajectories)}"
            )
        expected = len(trajectories[i - 1]) + 1, len(trajectories[j - 1]) + 1
        if diagram.shape != expected:
            raise ArgumentError(f"diagram of agents {(i, j)} has shape {diagram.shape}; expected {expected}")
