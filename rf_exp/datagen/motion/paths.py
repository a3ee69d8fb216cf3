"""Collision-free paths: a straight line in joint space where it is free, else RRT-Connect."""

from collections.abc import Callable

import numpy as np

from rf_exp.datagen.motion.state import Points
from rf_exp.datagen.motion.timing import densify

MAX_EDGES = 1000  # budget of tree edges for one plan, over all the ways to plan it: some seconds
MAX_SAMPLES = 600  # samples, whose spread about the straight line grows
_STEP_RAD = 0.25  # step of the trees, largest joint
_CHECK_EVERY = 5  # dense points; 0.05 rad between the checked ones

Free = Callable[[Points], bool]  # whether joint points (K, dof) are all collision-free
Tree = tuple[list[Points], list[int]]  # nodes (dof,) rad, and the index of the parent of each


class Search:
    """Path search for one plan. Once `edges` have been tried, only straight lines are found.

    The budget counts edges, not seconds, so that a plan does not depend on the speed of a machine.
    """

    def __init__(self, rng: np.random.Generator, edges: int = MAX_EDGES) -> None:
        self._rng, self._edges_left = rng, edges

    def path(self, start: Points, goal: Points, free: Free, limits_rad: Points) -> Points | None:
        """Via points (K, dof) from start to goal: a line, or by RRT-Connect (Kuffner and LaValle 2000)."""
        if edge_free(start, goal, free):
            return np.stack([start, goal])
        if not (free(start[None]) and free(goal[None])):
            return None
        low, high = limits_rad
        trees: list[Tree] = [([start], [-1]), ([goal], [-1])]
        for sample in range(MAX_SAMPLES):
            if self._edges_left <= 0:
                break
            a, b = trees[sample % 2], trees[1 - sample % 2]
            # Gaussian samples about the line find the way round a small obstacle sooner than uniform ones.
            middle = start + self._rng.uniform() * (goal - start)
            spread_rad = 0.2 + 0.8 * sample / MAX_SAMPLES
            target = np.clip(middle + self._rng.normal(0.0, spread_rad, len(start)), low, high)
            if self._grow(a, target, free) and (meeting := self._connect(b, a[0][-1], free)) is not None:
                path = np.array(_trace(a, len(a[0]) - 1)[::-1] + _trace(b, meeting))
                return _shortcut(path if sample % 2 == 0 else path[::-1], free)
        return None

    def _grow(self, tree: Tree, target: Points, free: Free) -> bool:
        """Adds one step towards `target`; returns whether it was free."""
        self._edges_left -= 1
        nodes, parents = tree
        near = int(np.argmin(np.abs(np.array(nodes) - target).max(axis=1)))
        delta = target - nodes[near]
        new = nodes[near] + delta * min(1.0, _STEP_RAD / max(np.abs(delta).max(), 1e-9))
        if not edge_free(nodes[near], new, free):
            return False
        nodes.append(new)
        parents.append(near)
        return True

    def _connect(self, tree: Tree, target: Points, free: Free) -> int | None:
        """Grows straight to `target`; returns the index of the node that reached it, if one did."""
        while self._grow(tree, target, free):
            if np.abs(tree[0][-1] - target).max() < 1e-9:
                return len(tree[0]) - 1
        return None


def edge_free(a: Points, b: Points, free: Free) -> bool:
    """Whether the straight joint line from a to b (dof,) is free."""
    points = densify(np.stack([a, b]))
    return free(np.concatenate([points[::_CHECK_EVERY], points[-1:]]))


def _trace(tree: Tree, index: int) -> list[Points]:
    nodes, parents = tree
    path = []
    while index >= 0:
        path.append(nodes[index])
        index = parents[index]
    return path


def _shortcut(path: Points, free: Free) -> Points:
    """The path without via points that a free straight line can replace, the longest lines first."""
    for span in range(len(path) - 1, 1, -1):
        for first in range(len(path) - span):
            if edge_free(path[first], path[first + span], free):
                ends = path[: first + 1], path[first + span :]
                return np.concatenate(
                    [_shortcut(ends[0], free)[:-1], path[[first]], _shortcut(ends[1], free)]
                )
    return path
