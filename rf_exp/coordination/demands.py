"""What is asked of a schedule, as cells of coordination diagrams, dwells and deadlines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

import numpy as np

from rf_exp.geometry import Mask
from rf_exp.types import Trajectory


class Rule(Protocol):
    """A constraint on time that knows what it asks of a schedule."""

    def demand(self, demands: "Demands") -> None:
        """Add what this constraint forbids."""
        ...


@dataclass(frozen=True)
class Closing:
    """A rule of a schedule: an agent stays out of a zone while another one, or its progress, closes it."""

    pair: tuple[int, int]  # (i, j), i < j
    cells: Mask  # (P_i, P_j) path positions that may not be at the same time

    def demand(self, demands: "Demands") -> None:
        demands.apart(*self.pair, self.cells)


class Demands:
    """What the rules ask of a schedule of trajectories. Agents from 1; positions on their paths."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        self.trajectories = tuple(trajectories)
        self.cells: dict[tuple[int, int], Mask] = {}
        self.dwells: dict[tuple[int, int], int] = {}  # (agent, position) -> steps to stay there
        self.after_dwell: list[tuple[int, int, int, int, bool]] = []
        self.deadlines: list[tuple[int, int, int]] = []  # (agent, position, steps) reached at the latest then

    def trajectory(self, agent: int) -> Trajectory:
        return self.trajectories[agent - 1]

    def shape(self, i: int, j: int) -> tuple[int, int]:
        """(P_i, P_j) of the diagram of two agents."""
        return len(self.trajectory(i)) + 1, len(self.trajectory(j)) + 1

    def forbid(self, a: int, rows: slice, b: int, columns: slice) -> None:
        """Agents a and b may not be at these positions at the same time."""
        i, j = sorted((a, b))
        mask = self.cells.setdefault((i, j), np.zeros(self.shape(i, j), dtype=bool))
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
        self.apart(i, j, done_i[:, None] != done_j[None, :])

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
    """How much a schedule forgives, and how much later than the shortest it is on purpose."""

    slack_steps: int  # by which any one agent may be late without meeting another
    pauses: Mapping[tuple[int, int], int]  # (agent, knot) -> steps it stays there at least


def joint_runs(trajectories: Sequence[Trajectory]) -> list[tuple[str, list[tuple[int, int, int]]]]:
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
