"""Where a schedule lets an agent stay though nobody is in its way."""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination.demands import Demands
from rf_exp.geometry import Mask


def hesitates(
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
