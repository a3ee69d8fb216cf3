"""Coordination diagrams of two agents: which pairs of positions on their paths may not be at one time.

O'Donnell and Lozano-Perez 1989, Deadlock-free and collision-free coordination of two robot manipulators.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Pair = tuple[int, int]
Diagram = NDArray[np.bool_]  # (P_i, P_j) True = forbidden

UNREACHABLE = np.iinfo(np.int32).max // 4


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
