"""Scheduling of rest-to-rest trajectories: path positions at every control step, or why there are none.

Rules become cells of coordination diagrams, dwells and deadlines (`Demands`), which one exact search obeys
(`search.solve`). Agents wait only at knots, where they are at rest anyway, so the motion of a schedule has
the accelerations of its trajectories.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, groupby
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import search
from rf_exp.coordination.search import UNREACHABLE, blocked_region, remaining
from rf_exp.errors import ArgumentError
from rf_exp.findings import Cause, CheckName, Doing, Finding, Violation
from rf_exp.geometry import Mask
from rf_exp.statements import Proposal
from rf_exp.types import CONTROL_DT_S, Schedule, Trajectory, arm_of, doing


class Rule(Protocol):
    """A constraint on schedules."""

    def demand(self, demands: "Demands") -> None:
        """Add what this constraint forbids."""
        ...


@dataclass(frozen=True)
class Closing:
    """Rule that forbids pairs of path positions, e.g. in a zone while another agent's progress closes it."""

    pair: tuple[int, int]  # (a, b)
    cells: Mask  # (P_a, P_b) path positions that are forbidden at the same time

    def demand(self, demands: "Demands") -> None:
        demands.of(*self.pair)[self.cells] = True


class Demands:
    """Demands of the rules on a schedule of trajectories. Agents from 1; positions on their paths."""

    def __init__(self, trajectories: Sequence[Trajectory], rules: Sequence[Rule] = ()) -> None:
        self.trajectories = tuple(trajectories)
        self.cells: dict[tuple[int, int], Mask] = {}
        self.dwells: dict[tuple[int, int], int] = {}  # (agent, position) -> steps to stay there
        self.after_dwell: list[tuple[int, int, int, int, bool]] = []
        self.deadlines: list[tuple[int, int, int]] = []  # (agent, position, latest step to reach it)
        for rule in rules:
            rule.demand(self)

    def trajectory(self, agent: int) -> Trajectory:
        return self.trajectories[agent - 1]

    def shape(self, i: int, j: int) -> tuple[int, int]:
        """(P_i, P_j) of the diagram of two agents."""
        return len(self.trajectory(i)) + 1, len(self.trajectory(j)) + 1

    def of(self, a: int, b: int) -> Mask:
        """(P_a, P_b) forbidden pairs of positions of two agents; a view, to be modified."""
        i, j = sorted((a, b))
        mask = self.cells.setdefault((i, j), np.zeros(self.shape(i, j), dtype=bool))
        return mask if a < b else mask.T

    def before(self, a: int, end: int, b: int, start: int) -> None:
        """b leaves position `start` only once a has reached `end`."""
        self.of(a, b)[:end, start + 1 :] = True

    def together(self, a: int, start_a: int, b: int, start_b: int, within_steps: int) -> None:
        """a and b leave their positions at most `within_steps` apart.

        Counted in positions, so the bound is cut to the length of the first segments: no agent waits there.
        """
        for first, start, other, other_start in ((a, start_a, b, start_b), (b, start_b, a, start_a)):
            knots = self.trajectory(first).knots
            run = min((knot for knot in knots if knot > start), default=start + 1) - start
            apart = max(0, min(within_steps, run - 1))
            self.of(first, other)[start + apart + 1 :, : other_start + 1] = True

    def lockstep(self, a: int, start_a: int, b: int, start_b: int, steps: int) -> None:
        """a and b run `steps` positions side by side, never one ahead of the other."""
        done_a, done_b = (
            np.clip(np.arange(count) - start, 0, steps)
            for count, start in zip(self.shape(a, b), (start_a, start_b), strict=True)
        )
        self.of(a, b)[done_a[:, None] != done_b] = True

    def delay(self, a: int, end: int, b: int, start: int, steps: int) -> None:
        """b leaves `start` at the earliest `steps` after a has reached `end`.

        The time is spent as a dwell: of a, where its path ends there anyway, otherwise of b.
        """
        at_end = end == len(self.trajectory(a))
        agent, position = (a, end) if at_end else (b, start)
        self.dwells[agent, position] = max(steps, self.dwells.get((agent, position), 0))
        self.after_dwell.append((a, end, b, start, at_end))


@dataclass(frozen=True)
class Delays:
    """Tolerance of a schedule to late agents, and deliberate pauses in it."""

    slack_steps: int  # by which any one agent may be late without coming too close to another
    pauses: Mapping[tuple[int, int], int]  # (agent, knot) -> minimum steps to stay there


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
    `begins_s`, in seconds since the start of the episode. Where none is found, a Violation says which pair
    cannot pass each other, or what else is the reason. Raises ArgumentError for trajectories that are not
    those of agents 1 to N, or for diagrams of another shape.
    """
    _agents(trajectories)
    diagrams = diagrams or {}
    _shapes(trajectories, diagrams)
    demands, unscheduled = Demands(trajectories, rules), _Unscheduled(trajectories, diagrams, begins_s)
    for label, runs in _joint_runs(trajectories):
        for (a, start_a, length_a), (b, start_b, length_b) in combinations(runs, 2):
            if length_a != length_b:
                longer_s, who = abs(length_a - length_b) * CONTROL_DT_S, (a, b)
                return unscheduled.found(Finding.UNEQUAL, longer_s, unit="s", agents=who, subgoals=(label,))
            demands.lockstep(a, start_a, b, start_b, length_a)
    asked = {*demands.dwells}
    hard, apart = diagrams, {}
    if delays is not None:
        joined = {pair: _joined(demands, pair) for pair in diagrams}
        hard = {pair: diagram & joined[pair] for pair, diagram in diagrams.items()}
        apart = {pair: diagram & ~joined[pair] for pair, diagram in diagrams.items()}
        for key, steps in delays.pauses.items():
            demands.dwells[key] = max(steps, demands.dwells.get(key, 0))
    problem, real = _problem(demands, hard, apart, delays.slack_steps if delays is not None else 0)
    answer = search.solve(problem, budget)
    if isinstance(answer, search.Impossible):
        return unscheduled.why(answer, problem, real)
    columns = [real[k][answer.positions[:, k]] for k in range(len(trajectories))]
    found = Schedule(np.stack(columns, axis=1), answer.bound)
    if delays is None:
        return found
    return replace(found, hesitates=hesitates(found.positions, demands, diagrams, asked, delays.slack_steps))


def _joint_runs(trajectories: Sequence[Trajectory]) -> list[tuple[str, list[tuple[int, int, int]]]]:
    """Label of joined segments -> (agent, first position, length) of each agent that has it."""
    found: dict[str, list[tuple[int, int, int]]] = {}
    for trajectory in trajectories:
        start = 0
        for label, run in groupby(trajectory.segments, key=lambda segment: segment.joined):
            length = sum(map(len, run))
            if label is not None:
                found.setdefault(label, []).append((trajectory.agent, start, length))
            start += length
    return sorted(found.items())


def _joined(demands: Demands, pair: tuple[int, int]) -> Mask:
    """Pairs of positions in joined segments of two agents: neither can be late alone."""
    i, j = pair
    found = np.zeros(demands.shape(i, j), dtype=bool)
    for _, runs in _joint_runs(demands.trajectories):
        of = {agent: slice(start, start + length + 1) for agent, start, length in runs}
        if i in of and j in of:
            found[of[i], of[j]] = True
    return found


def _problem(
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    apart: Mapping[tuple[int, int], Mask],
    slack: int,
) -> tuple[search.Problem, tuple[NDArray[np.int64], ...]]:
    """The search problem, in which dwells are extra positions, and the path position of each position."""
    real, knots = [], []
    for trajectory in demands.trajectories:
        repeats = np.ones(len(trajectory) + 1, dtype=int)
        for (agent, position), steps in demands.dwells.items():
            if agent == trajectory.agent:
                repeats[position] += steps
        last = np.cumsum(repeats) - 1  # last problem position of each path position
        first = last - repeats + 1
        real.append(np.repeat(np.arange(len(repeats)), repeats))
        knots.append(frozenset(int(at) for knot in trajectory.knots for at in (first[knot], last[knot])))
    forbidden: dict[tuple[int, int], Mask] = {}
    for i, j in {*diagrams, *demands.cells}:
        nothing = np.zeros(demands.shape(i, j), dtype=bool)
        mask = diagrams.get((i, j), nothing) | demands.cells.get((i, j), nothing)
        forbidden[i - 1, j - 1] = mask[np.ix_(real[i - 1], real[j - 1])]
    for a, end, b, start, at_end in demands.after_dwell:
        i, j = sorted((a, b))
        shape = len(real[i - 1]), len(real[j - 1])
        mask = forbidden.setdefault((i - 1, j - 1), np.zeros(shape, dtype=bool))
        side = "right" if at_end else "left"
        until = int(np.searchsorted(real[a - 1], end, side)) - at_end
        begin = int(np.searchsorted(real[b - 1], start, side)) - at_end
        (mask if a < b else mask.T)[:until, begin + 1 :] = True
    deadlines = tuple(
        (agent - 1, int(np.searchsorted(real[agent - 1], position)), steps)
        for agent, position, steps in demands.deadlines
    )
    lengths = tuple(len(each) - 1 for each in real)
    passed = {(i - 1, j - 1): mask[np.ix_(real[i - 1], real[j - 1])] for (i, j), mask in apart.items()}
    return search.Problem(tuple(knots), lengths, forbidden, deadlines, passed, slack), tuple(real)


def sequential(trajectories: Sequence[Trajectory], proposal: Proposal) -> Schedule:
    """Schedule of one subgoal after another, in the order of the plan: without temporal constraints."""
    _agents(trajectories)
    # Agents that move without a subgoal in the plan make way for the others: they move first.
    turns = [(each.agent, len(each)) for each in trajectories if not proposal.of(each.agent)]  # agent, steps
    waiting = {  # agent -> subgoals and the steps of each
        each.agent: [
            (subgoal, sum(map(len, run)))
            for subgoal, run in groupby(each.segments, key=lambda segment: segment.subgoal)
        ]
        for each in trajectories
        if proposal.of(each.agent)
    }
    for subgoal in proposal.subgoals:
        runs = waiting.get(subgoal.agent, [])
        if runs and runs[0][0] == subgoal:
            turns.append((subgoal.agent, runs.pop(0)[1]))
        while runs and runs[0][0] not in proposal.subgoals:  # added by the planner for it
            turns.append((subgoal.agent, runs.pop(0)[1]))
    for agent, runs in waiting.items():  # subgoals that are not in the plan come last
        turns += [(agent, steps) for _, steps in runs]
    movers, steps = np.array(turns, dtype=np.int64).reshape(-1, 2).T
    moves = np.repeat(movers, steps)[:, None] == [trajectory.agent for trajectory in trajectories]  # (T, N)
    positions = np.cumsum(np.pad(moves, ((1, 0), (0, 0))), axis=0)
    return Schedule(positions, max(map(len, trajectories)))


def alike(paths: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Paths (P, A) of arms with different numbers of joints, padded with zeros before the gripper."""
    size = max(path.shape[1] for path in paths)
    lacks = (np.zeros((len(path), size - path.shape[1])) for path in paths)
    return [np.hstack([path[:, :-1], zeros, path[:, -1:]]) for path, zeros in zip(paths, lacks, strict=True)]


def actions(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) joint targets rad and gripper command: the action of step t leads to row t + 1."""
    _agents(trajectories)
    paths = alike([trajectory.path() for trajectory in trajectories])
    return np.stack([path[timed.positions[1:, k]] for k, path in enumerate(paths)], axis=1)


def intended(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) as `actions`, but an agent that hesitates has the next position of its path as its action.

    In its last hesitating step the joint target is the present position: motion begins there at rest, and
    from one position further on it would have to exceed the limits of its path by half to keep up with it.
    """
    found = actions(trajectories, timed)
    if timed.hesitates is None:
        return found
    for k, path in enumerate(alike([trajectory.path() for trajectory in trajectories])):
        hesitates = timed.hesitates[1:, k]
        found[hesitates, k] = path[timed.positions[1:, k][hesitates] + 1]
        last = hesitates & ~np.append(hesitates[1:], False)
        arm_of(found)[last, k] = arm_of(path)[timed.positions[1:, k][last]]
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


def hesitates(
    positions: NDArray[np.int64],
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    asked: Collection[tuple[int, int]],
    slack: int,
) -> NDArray[np.bool_]:
    """(T + 1, N) whether an agent stays though it could go on, except for dwells that are `asked` for."""
    forbidden = {pair: demands.cells.get(pair, False) | mask for pair, mask in diagrams.items()}
    forbidden = {**demands.cells, **forbidden}
    found = np.zeros(positions.shape, dtype=bool)

    def free_from(agent: int, start: int, end: int, knot: int) -> int:
        """The first step of a stay (start, end) from which on an agent could have gone on to its next knot.

        The others move as scheduled, and up to `slack` steps earlier or later. The agent waits at that knot
        until the schedule reaches it.
        """
        own = positions[:, agent - 1]
        until = int(np.searchsorted(own, knot))  # the step at which the schedule reaches the knot
        others = [(mask, j) for (i, j), mask in forbidden.items() if i == agent]
        others += [(mask.T, i) for (i, j), mask in forbidden.items() if j == agent]
        for leaves in range(end - 1, start - 1, -1):
            steps = np.arange(leaves, until + 1)
            goes = np.minimum(own[start] + steps - leaves, knot)
            for cells, other in others:
                for late in range(-slack, slack + 1):
                    there = positions[np.clip(steps + late, 0, len(positions) - 1), other - 1]
                    if cells[goes, there].any():
                        return leaves + 1
        return start

    for trajectory in demands.trajectories:
        agent, own = trajectory.agent, positions[:, trajectory.agent - 1]
        arrived = np.flatnonzero(np.diff(own, prepend=-1))
        left = [*(arrived[1:] - 1), len(positions) - 1]
        for start, end in zip(arrived.tolist(), left, strict=True):
            # No knot follows at the end of the path.
            following = [knot for knot in trajectory.knots if knot > own[start]]
            if end > start and following and (agent, int(own[start])) not in asked:
                found[free_from(agent, start, end, following[0]) + 1 : end + 1, agent - 1] = True
    return found


@dataclass(frozen=True, eq=False)
class _Unscheduled:
    """Finds out why there is no schedule. Agents from 1; masks over positions on their paths."""

    trajectories: Sequence[Trajectory]
    diagrams: Mapping[tuple[int, int], Mask]  # which pairs of positions are too close
    begins_s: float  # when the schedule would begin, since the start of the episode

    def why(
        self, answer: search.Impossible, problem: search.Problem, real: tuple[NDArray[np.int64], ...]
    ) -> Violation:
        """The violation. `real`: path position of each position of the problem, by agent."""
        everyone = tuple(trajectory.agent for trajectory in self.trajectories)
        if not answer.proven:
            return self.found(Finding.NO_SCHEDULE, agents=everyone)
        if answer.pair is not None:
            return self._pair(answer.pair, problem, real)
        return self._late(problem) or self.found(Finding.NOT_ALL, agents=everyone)

    def _pair(
        self, pair: tuple[int, int], problem: search.Problem, real: tuple[NDArray[np.int64], ...]
    ) -> Violation:
        """Violation of two agents that cannot pass each other: for space, or for the demanded orders."""
        i, j = pair[0] + 1, pair[1] + 1
        a, b = self.trajectories[i - 1], self.trajectories[j - 1]
        collision = self.diagrams.get((i, j))
        found = None if collision is None else _collision(a, b, collision)
        if collision is not None and found is not None:
            share = float(collision.mean())  # fraction of pairs that are too close
            return self.found(found[0], share, cause=Cause.SPACE, agents=(i, j), doing=found[1])
        knots_a, knots_b = (sorted(problem.knots[agent]) for agent in pair)
        row, column = blocked_region(problem.diagrams[pair], knots_a, knots_b)
        ways = collision is not None and collision.any()
        doing = _at(a, int(real[i - 1][row])), _at(b, int(real[j - 1][column]))
        return self.found(Finding.ORDERS_OR_WAYS if ways else Finding.ORDERS, agents=(i, j), doing=doing)

    def _late(self, problem: search.Problem) -> Violation | None:
        """Violation of the deadline that is missed by most; None where deadlines are not the reason."""
        free = search.solve(search.Problem(problem.knots, problem.lengths, problem.diagrams))
        if not problem.deadlines or not isinstance(free, search.Found):
            return None
        late = []
        for agent, position, latest in problem.deadlines:
            reached = int(np.searchsorted(free.positions[:, agent], position))
            late.append((reached - latest, agent + 1, reached * CONTROL_DT_S, latest * CONTROL_DT_S))
        _, agent, needed_s, allowed_s = max(late)
        time_s = self.begins_s + needed_s
        return self.found(Finding.DEADLINE, needed_s, allowed_s, "s", time_s=time_s, agents=(agent,))

    @cached_property
    def found(self) -> partial[Violation]:
        return partial(Violation, check=CheckName.SCHEDULING, cause=Cause.TIME, time_s=self.begins_s)


def _collision(
    a: Trajectory, b: Trajectory, collision: Mask
) -> tuple[Finding, tuple[Doing | None, ...]] | None:
    """Why collisions alone leave no schedule, and where both agents are then; None when they leave one."""
    if remaining(collision, frozenset(a.knots), frozenset(b.knots))[0, 0] < UNREACHABLE:
        return None
    if collision[0, 0]:
        return Finding.CLOSE_AT_FIRST, ()
    if collision[-1, -1]:
        return Finding.CLOSE_AT_LAST, (_at(a, len(a)), _at(b, len(b)))
    for moving, diagram in ((a, collision), (b, collision.T)):
        walls = np.flatnonzero(diagram.all(axis=1))
        if not len(walls):
            walls = np.flatnonzero(diagram[:, 0] & diagram[:, -1])
        if len(walls):  # the other agent is at rest
            blocked = _at(moving, int(walls[0]))
            return Finding.PARKED, (blocked, None) if moving is a else (None, blocked)
    row, column = blocked_region(collision, a.knots, b.knots)
    return Finding.BLOCKED_BOTH, (_at(a, row), _at(b, column))


def _at(trajectory: Trajectory, position: int) -> Doing | None:
    """Activity of an agent at a path position; None: it does not move."""
    return doing(trajectory.segment_at(position), position * CONTROL_DT_S)
