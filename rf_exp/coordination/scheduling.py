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
from rf_exp.coordination.search import UNREACHABLE, farthest_reachable, steps_to_go
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
class ForbiddenPairs:
    """Rule that forbids pairs of path positions, e.g. in a zone while another agent's progress closes it."""

    pair: tuple[int, int]  # (a, b)
    cells: Mask  # (P_a, P_b) path positions that are forbidden at the same time

    def demand(self, demands: "Demands") -> None:
        demands.forbidden_cells(*self.pair)[self.cells] = True


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

    def forbidden_cells(self, a: int, b: int) -> Mask:
        """(P_a, P_b) forbidden pairs of positions of two agents; a view, to be modified."""
        i, j = sorted((a, b))
        mask = self.cells.setdefault((i, j), np.zeros(self.shape(i, j), dtype=bool))
        return mask if a < b else mask.T

    def before(self, a: int, end: int, b: int, start: int) -> None:
        """b leaves position `start` only once a has reached `end`."""
        self.forbidden_cells(a, b)[:end, start + 1 :] = True

    def together(self, a: int, start_a: int, b: int, start_b: int, within_steps: int) -> None:
        """a and b leave their positions at most `within_steps` apart.

        Counted in positions, so the bound is cut to the length of the first segments: no agent waits there.
        """
        for leader, start, other, other_start in ((a, start_a, b, start_b), (b, start_b, a, start_a)):
            knots = self.trajectory(leader).knots
            length = min((knot for knot in knots if knot > start), default=start + 1) - start
            max_lead = max(0, min(within_steps, length - 1))
            self.forbidden_cells(leader, other)[start + max_lead + 1 :, : other_start + 1] = True

    def lockstep(self, a: int, start_a: int, b: int, start_b: int, steps: int) -> None:
        """a and b run `steps` positions side by side, never one ahead of the other."""
        done_a, done_b = (
            np.clip(np.arange(count) - start, 0, steps)
            for count, start in zip(self.shape(a, b), (start_a, start_b), strict=True)
        )
        self.forbidden_cells(a, b)[done_a[:, None] != done_b] = True

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
    _check_agents(trajectories)
    diagrams = diagrams or {}
    _check_shapes(trajectories, diagrams)
    demands, infeasibility = Demands(trajectories, rules), _Infeasibility(trajectories, diagrams, begins_s)
    for label, runs in _joined_runs(trajectories):
        for (a, start_a, length_a), (b, start_b, length_b) in combinations(runs, 2):
            if length_a != length_b:
                longer_s, agents = abs(length_a - length_b) * CONTROL_DT_S, (a, b)
                return infeasibility.violation(
                    Finding.UNEQUAL, longer_s, unit="s", agents=agents, subgoals=(label,)
                )
            demands.lockstep(a, start_a, b, start_b, length_a)
    required_dwells = {*demands.dwells}
    without_slack, with_slack = diagrams, {}
    if delays is not None:
        joined = {pair: _joined_cells(demands, pair) for pair in diagrams}
        without_slack = {pair: diagram & joined[pair] for pair, diagram in diagrams.items()}
        with_slack = {pair: diagram & ~joined[pair] for pair, diagram in diagrams.items()}
        for key, steps in delays.pauses.items():
            demands.dwells[key] = max(steps, demands.dwells.get(key, 0))
    problem, path_positions = _search_problem(
        demands, without_slack, with_slack, delays.slack_steps if delays is not None else 0
    )
    result = search.solve(problem, budget)
    if isinstance(result, search.Infeasible):
        return infeasibility.explain(result, problem, path_positions)
    columns = [path_positions[k][result.positions[:, k]] for k in range(len(trajectories))]
    timed = Schedule(np.stack(columns, axis=1), result.bound)
    if delays is None:
        return timed
    return replace(
        timed,
        hesitates=hesitation_mask(timed.positions, demands, diagrams, required_dwells, delays.slack_steps),
    )


def _joined_runs(trajectories: Sequence[Trajectory]) -> list[tuple[str, list[tuple[int, int, int]]]]:
    """Label of joined segments -> (agent, first position, length) of each agent that has it."""
    runs_by_label: dict[str, list[tuple[int, int, int]]] = {}
    for trajectory in trajectories:
        start = 0
        for label, run in groupby(trajectory.segments, key=lambda segment: segment.joined):
            length = sum(map(len, run))
            if label is not None:
                runs_by_label.setdefault(label, []).append((trajectory.agent, start, length))
            start += length
    return sorted(runs_by_label.items())


def _joined_cells(demands: Demands, pair: tuple[int, int]) -> Mask:
    """Pairs of positions in joined segments of two agents: neither can be late alone."""
    i, j = pair
    cells = np.zeros(demands.shape(i, j), dtype=bool)
    for _, runs in _joined_runs(demands.trajectories):
        ranges = {agent: slice(start, start + length + 1) for agent, start, length in runs}
        if i in ranges and j in ranges:
            cells[ranges[i], ranges[j]] = True
    return cells


def _search_problem(
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    with_slack: Mapping[tuple[int, int], Mask],
    slack: int,
) -> tuple[search.Problem, tuple[NDArray[np.int64], ...]]:
    """The search problem, in which dwells are extra positions, and the path position of each position."""
    path_positions, knots = [], []
    for trajectory in demands.trajectories:
        repeats = np.ones(len(trajectory) + 1, dtype=int)
        for (agent, position), steps in demands.dwells.items():
            if agent == trajectory.agent:
                repeats[position] += steps
        last = np.cumsum(repeats) - 1  # last problem position of each path position
        first = last - repeats + 1
        path_positions.append(np.repeat(np.arange(len(repeats)), repeats))
        knots.append(frozenset(int(at) for knot in trajectory.knots for at in (first[knot], last[knot])))
    forbidden: dict[tuple[int, int], Mask] = {}
    for i, j in {*diagrams, *demands.cells}:
        empty = np.zeros(demands.shape(i, j), dtype=bool)
        mask = diagrams.get((i, j), empty) | demands.cells.get((i, j), empty)
        forbidden[i - 1, j - 1] = mask[np.ix_(path_positions[i - 1], path_positions[j - 1])]
    for a, end, b, start, at_end in demands.after_dwell:
        i, j = sorted((a, b))
        shape = len(path_positions[i - 1]), len(path_positions[j - 1])
        mask = forbidden.setdefault((i - 1, j - 1), np.zeros(shape, dtype=bool))
        side = "right" if at_end else "left"
        until = int(np.searchsorted(path_positions[a - 1], end, side)) - at_end
        begin = int(np.searchsorted(path_positions[b - 1], start, side)) - at_end
        (mask if a < b else mask.T)[:until, begin + 1 :] = True
    deadlines = tuple(
        (agent - 1, int(np.searchsorted(path_positions[agent - 1], position)), steps)
        for agent, position, steps in demands.deadlines
    )
    lengths = tuple(len(positions) - 1 for positions in path_positions)
    slack_diagrams = {
        (i - 1, j - 1): mask[np.ix_(path_positions[i - 1], path_positions[j - 1])]
        for (i, j), mask in with_slack.items()
    }
    return search.Problem(tuple(knots), lengths, forbidden, deadlines, slack_diagrams, slack), tuple(
        path_positions
    )


def sequential(trajectories: Sequence[Trajectory], proposal: Proposal) -> Schedule:
    """Schedule of one subgoal after another, in the order of the plan: without temporal constraints."""
    _check_agents(trajectories)
    # Agents that move without a subgoal in the plan make way for the others: they move first.
    turns = [
        (trajectory.agent, len(trajectory))
        for trajectory in trajectories
        if not proposal.subgoals_of(trajectory.agent)
    ]  # agent, steps
    runs_by_agent = {  # agent -> subgoals and the steps of each
        trajectory.agent: [
            (subgoal, sum(map(len, run)))
            for subgoal, run in groupby(trajectory.segments, key=lambda segment: segment.subgoal)
        ]
        for trajectory in trajectories
        if proposal.subgoals_of(trajectory.agent)
    }
    for subgoal in proposal.subgoals:
        runs = runs_by_agent.get(subgoal.agent, [])
        if runs and runs[0][0] == subgoal:
            turns.append((subgoal.agent, runs.pop(0)[1]))
        while runs and runs[0][0] not in proposal.subgoals:  # added by the planner for it
            turns.append((subgoal.agent, runs.pop(0)[1]))
    for agent, runs in runs_by_agent.items():  # subgoals that are not in the plan come last
        turns += [(agent, steps) for _, steps in runs]
    moving_agents, steps = np.array(turns, dtype=np.int64).reshape(-1, 2).T
    moves = np.repeat(moving_agents, steps)[:, None] == [
        trajectory.agent for trajectory in trajectories
    ]  # (T, N)
    positions = np.cumsum(np.pad(moves, ((1, 0), (0, 0))), axis=0)
    return Schedule(positions, max(map(len, trajectories)))


def pad_paths(paths: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Paths (P, A) of arms with different numbers of joints, padded with zeros before the gripper."""
    width = max(path.shape[1] for path in paths)
    padding = (np.zeros((len(path), width - path.shape[1])) for path in paths)
    return [
        np.hstack([path[:, :-1], zeros, path[:, -1:]]) for path, zeros in zip(paths, padding, strict=True)
    ]


def scheduled_actions(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) joint targets rad and gripper command: the action of step t leads to row t + 1."""
    _check_agents(trajectories)
    paths = pad_paths([trajectory.path() for trajectory in trajectories])
    return np.stack([path[timed.positions[1:, k]] for k, path in enumerate(paths)], axis=1)


def intended_actions(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) as `scheduled_actions`, but a hesitating agent's action is the next position of its path.

    In its last hesitating step the joint target is the present position: motion begins there at rest, and
    from one position further on it would have to exceed the limits of its path by half to keep up with it.
    """
    actions = scheduled_actions(trajectories, timed)
    if timed.hesitates is None:
        return actions
    for k, path in enumerate(pad_paths([trajectory.path() for trajectory in trajectories])):
        waiting = timed.hesitates[1:, k]
        actions[waiting, k] = path[timed.positions[1:, k][waiting] + 1]
        last_waiting = waiting & ~np.append(waiting[1:], False)
        arm_of(actions)[last_waiting, k] = arm_of(path)[timed.positions[1:, k][last_waiting]]
    return actions


def _check_agents(trajectories: Sequence[Trajectory]) -> None:
    agents = [trajectory.agent for trajectory in trajectories]
    if agents != list(range(1, len(agents) + 1)):
        raise ArgumentError(
            f"trajectories are of agents {agents}; expected one for each agent 1 to N, in order"
        )


def _check_shapes(trajectories: Sequence[Trajectory], diagrams: Mapping[tuple[int, int], Mask]) -> None:
    for (i, j), diagram in diagrams.items():
        if not 1 <= i < j <= len(trajectories):
            raise ArgumentError(
                f"diagram of agents {(i, j)}; expected i < j of agents 1 to {len(trajectories)}"
            )
        expected = len(trajectories[i - 1]) + 1, len(trajectories[j - 1]) + 1
        if diagram.shape != expected:
            raise ArgumentError(f"diagram of agents {(i, j)} has shape {diagram.shape}; expected {expected}")


def hesitation_mask(
    positions: NDArray[np.int64],
    demands: Demands,
    diagrams: Mapping[tuple[int, int], Mask],
    required_dwells: Collection[tuple[int, int]],
    slack: int,
) -> NDArray[np.bool_]:
    """(T + 1, N) whether an agent stays though it could go on, except for `required_dwells`."""
    forbidden = {pair: demands.cells.get(pair, False) | mask for pair, mask in diagrams.items()}
    forbidden = {**demands.cells, **forbidden}
    hesitating = np.zeros(positions.shape, dtype=bool)

    def first_free_step(agent: int, start: int, end: int, knot: int) -> int:
        """The first step of a stay (start, end) from which on an agent could have gone on to its next knot.

        The others move as scheduled, and up to `slack` steps earlier or later. The agent waits at that knot
        until the schedule reaches it.
        """
        own_path = positions[:, agent - 1]
        until = int(np.searchsorted(own_path, knot))  # the step at which the schedule reaches the knot
        other_cells = [(mask, j) for (i, j), mask in forbidden.items() if i == agent]
        other_cells += [(mask.T, i) for (i, j), mask in forbidden.items() if j == agent]
        for departure in range(end - 1, start - 1, -1):
            steps = np.arange(departure, until + 1)
            own_positions = np.minimum(own_path[start] + steps - departure, knot)
            for cells, other in other_cells:
                for shift in range(-slack, slack + 1):
                    other_positions = positions[np.clip(steps + shift, 0, len(positions) - 1), other - 1]
                    if cells[own_positions, other_positions].any():
                        return departure + 1
        return start

    for trajectory in demands.trajectories:
        agent, own_path = trajectory.agent, positions[:, trajectory.agent - 1]
        arrived = np.flatnonzero(np.diff(own_path, prepend=-1))
        departed = [*(arrived[1:] - 1), len(positions) - 1]
        for start, end in zip(arrived.tolist(), departed, strict=True):
            # No knot follows at the end of the path.
            following = [knot for knot in trajectory.knots if knot > own_path[start]]
            if end > start and following and (agent, int(own_path[start])) not in required_dwells:
                hesitating[first_free_step(agent, start, end, following[0]) + 1 : end + 1, agent - 1] = True
    return hesitating


@dataclass(frozen=True, eq=False)
class _Infeasibility:
    """Finds out why there is no schedule. Agents from 1; masks over positions on their paths."""

    trajectories: Sequence[Trajectory]
    diagrams: Mapping[tuple[int, int], Mask]  # which pairs of positions are too close
    begins_s: float  # when the schedule would begin, since the start of the episode

    def explain(
        self,
        answer: search.Infeasible,
        problem: search.Problem,
        path_positions: tuple[NDArray[np.int64], ...],
    ) -> Violation:
        """The violation. `path_positions`: path position of each position of the problem, by agent."""
        agents = tuple(trajectory.agent for trajectory in self.trajectories)
        if not answer.proven:
            return self.violation(Finding.NO_SCHEDULE, agents=agents)
        if answer.pair is not None:
            return self._pair_violation(answer.pair, problem, path_positions)
        return self._deadline_violation(problem) or self.violation(Finding.NOT_ALL, agents=agents)

    def _pair_violation(
        self, pair: tuple[int, int], problem: search.Problem, path_positions: tuple[NDArray[np.int64], ...]
    ) -> Violation:
        """Violation of two agents that cannot pass each other: for space, or for the demanded orders."""
        i, j = pair[0] + 1, pair[1] + 1
        a, b = self.trajectories[i - 1], self.trajectories[j - 1]
        collision = self.diagrams.get((i, j))
        reason = None if collision is None else _collision_reason(a, b, collision)
        if collision is not None and reason is not None:
            share = float(collision.mean())  # fraction of pairs that are too close
            return self.violation(reason[0], share, cause=Cause.SPACE, agents=(i, j), doing=reason[1])
        knots_a, knots_b = (sorted(problem.knots[agent]) for agent in pair)
        row, column = farthest_reachable(problem.diagrams[pair], knots_a, knots_b)
        ways = collision is not None and collision.any()
        doing = (
            _activity_at(a, int(path_positions[i - 1][row])),
            _activity_at(b, int(path_positions[j - 1][column])),
        )
        return self.violation(Finding.ORDERS_OR_WAYS if ways else Finding.ORDERS, agents=(i, j), doing=doing)

    def _deadline_violation(self, problem: search.Problem) -> Violation | None:
        """Violation of the deadline that is missed by most; None where deadlines are not the reason."""
        unconstrained = search.solve(search.Problem(problem.knots, problem.lengths, problem.diagrams))
        if not problem.deadlines or not isinstance(unconstrained, search.Solution):
            return None
        missed = []
        for agent, position, latest in problem.deadlines:
            reached = int(np.searchsorted(unconstrained.positions[:, agent], position))
            missed.append((reached - latest, agent + 1, reached * CONTROL_DT_S, latest * CONTROL_DT_S))
        _, agent, needed_s, allowed_s = max(missed)
        time_s = self.begins_s + needed_s
        return self.violation(Finding.DEADLINE, needed_s, allowed_s, "s", time_s=time_s, agents=(agent,))

    @cached_property
    def violation(self) -> partial[Violation]:
        return partial(Violation, check=CheckName.SCHEDULING, cause=Cause.TIME, time_s=self.begins_s)


def _collision_reason(
    a: Trajectory, b: Trajectory, collision: Mask
) -> tuple[Finding, tuple[Doing | None, ...]] | None:
    """Why collisions alone leave no schedule, and where both agents are then; None when they leave one."""
    if steps_to_go(collision, frozenset(a.knots), frozenset(b.knots))[0, 0] < UNREACHABLE:
        return None
    if collision[0, 0]:
        return Finding.CLOSE_AT_FIRST, ()
    if collision[-1, -1]:
        return Finding.CLOSE_AT_LAST, (_activity_at(a, len(a)), _activity_at(b, len(b)))
    for moving, diagram in ((a, collision), (b, collision.T)):
        walls = np.flatnonzero(diagram.all(axis=1))
        if not len(walls):
            walls = np.flatnonzero(diagram[:, 0] & diagram[:, -1])
        if len(walls):  # the other agent is at rest
            blocked = _activity_at(moving, int(walls[0]))
            return Finding.PARKED, (blocked, None) if moving is a else (None, blocked)
    row, column = farthest_reachable(collision, a.knots, b.knots)
    return Finding.BLOCKED_BOTH, (_activity_at(a, row), _activity_at(b, column))


def _activity_at(trajectory: Trajectory, position: int) -> Doing | None:
    """Activity of an agent at a path position; None: it does not move."""
    return doing(trajectory.segment_at(position), position * CONTROL_DT_S)
