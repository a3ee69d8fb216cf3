"""From rest-to-rest trajectories to a schedule: who is where at which control step.

All constraints on time become cells of coordination diagrams (`Demands`), which one exact search
serves (`search.solve`). Agents wait only at knots, where they stand still anyway, so the motion of
a schedule has the accelerations of its trajectories.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, groupby

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import search
from rf_exp.coordination.demands import Delays, Demands, Rule, joint_runs
from rf_exp.coordination.hesitation import hesitates
from rf_exp.coordination.unscheduled import Unscheduled
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.geometry import Mask
from rf_exp.statements import Proposal
from rf_exp.types import Schedule, Segment, Subgoal, Trajectory, arm_of


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
    return replace(found, hesitates=hesitates(found.positions, demands, diagrams, asked, delays.slack_steps))


def _joined(demands: Demands, pair: tuple[int, int]) -> Mask:
    """Positions at which two agents carry one thing: neither can be late alone."""
    i, j = pair
    found = np.zeros((len(demands.trajectory(i)) + 1, len(demands.trajectory(j)) + 1), dtype=bool)
    for _, runs in joint_runs(demands.trajectories):
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


def sequential(trajectories: Sequence[Trajectory], proposal: Proposal) -> Schedule:
    """Sequential execution, subgoal by subgoal in the order of the plan: without a model of time."""
    _agents(trajectories)
    # Who moves without being named in the plan yields to those who are: that comes first.
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


def alike(paths: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Paths (P, A) of arms of different sizes: zeros for the joints that one lacks, before its gripper."""
    size = max(path.shape[1] for path in paths)
    lacks = (np.zeros((len(path), size - path.shape[1])) for path in paths)
    return [np.hstack([path[:, :-1], zeros, path[:, -1:]]) for path, zeros in zip(paths, lacks, strict=True)]


def actions(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) joint targets rad and gripper command: the action of step t leads to row t + 1."""
    _agents(trajectories)
    paths = alike([trajectory.path() for trajectory in trajectories])
    return np.stack([path[timed.positions[1:, k]] for k, path in enumerate(paths)], axis=1)


def intended(trajectories: Sequence[Trajectory], timed: Schedule) -> NDArray[np.float64]:
    """(T, N, A) as `actions`, but an agent that hesitates means to go on.

    In the step before it does its arm is meant to be where it stands. Motion begins at rest there; from one
    position further on it would have to be half as steep again as the limits of its path to keep up with it.
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
