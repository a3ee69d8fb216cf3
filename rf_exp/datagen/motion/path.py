"""Collision-free joint paths: the straight line where it is free, otherwise RRT-Connect."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.motion.timing import densify

Free = Callable[[NDArray[np.float64]], bool]  # whether joint points (K, dof) are all collision-free

_STEP_RAD = 0.25  # growth of the trees, largest joint
_CHECK_EVERY = 5  # dense points; 0.05 rad between the checked ones


def edge_free(a: NDArray[np.float64], b: NDArray[np.float64], free: Free) -> bool:
    """Whether the straight joint line from a to b (dof,) is free."""
    points = densify(np.stack([a, b]))
    return free(np.concatenate([points[::_CHECK_EVERY], points[-1:]]))


def find_path(
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    free: Free,
    limits_rad: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    iterations: int = 600,
) -> NDArray[np.float64] | None:
    """Via points (K, dof) rad from start to goal, within limits (2, dof), or None where none was found.

    RRT-Connect (Kuffner and LaValle 2000), then shortcuts. Deterministic for a given `rng`.
    """
    if edge_free(start, goal, free):
        return np.stack([start, goal])
    if not (free(start[None]) and free(goal[None])):
        return None
    low, high = limits_rad
    trees: list[tuple[list[NDArray[np.float64]], list[int]]] = [([start], [-1]), ([goal], [-1])]
    for iteration in range(iterations):
        a, b = trees[iteration % 2], trees[1 - iteration % 2]
        # A Gaussian about the straight line finds the way round a small obstacle sooner than a uniform draw.
        middle = start + rng.uniform() * (goal - start)
        sample = np.clip(middle + rng.normal(0.0, 0.2 + 0.8 * iteration / iterations, len(start)), low, high)
        if _grow(a, sample, free) and (meeting := _connect(b, a[0][-1], free)) is not None:
            forward = _trace(a, len(a[0]) - 1)[::-1]
            backward = _trace(b, meeting)
            path = np.array(forward + backward)
            return _shortcut(path if iteration % 2 == 0 else path[::-1], free)
    return None


def _nearest(nodes: list[NDArray[np.float64]], point: NDArray[np.float64]) -> int:
    return int(np.argmin(np.abs(np.array(nodes) - point).max(axis=1)))


def _grow(tree: tuple[list[NDArray[np.float64]], list[int]], target: NDArray[np.float64], free: Free) -> bool:
    """Adds one step towards `target`; whether it was free."""
    nodes, parents = tree
    near = _nearest(nodes, target)
    delta = target - nodes[near]
    new = nodes[near] + delta * min(1.0, _STEP_RAD / max(np.abs(delta).max(), 1e-9))
    if not edge_free(nodes[near], new, free):
        return False
    nodes.append(new)
    parents.append(near)
    return True


def _connect(
    tree: tuple[list[NDArray[np.float64]], list[int]], target: NDArray[np.float64], free: Free
) -> int | None:
    """Grows straight to `target` as far as it goes; the index of the node that reached it."""
    while _grow(tree, target, free):
        if np.abs(tree[0][-1] - target).max() < 1e-9:
            return len(tree[0]) - 1
    return None


def _trace(tree: tuple[list[NDArray[np.float64]], list[int]], index: int) -> list[NDArray[np.float64]]:
    nodes, parents = tree
    path = []
    while index >= 0:
        path.append(nodes[index])
        index = parents[index]
    return path


def _shortcut(path: NDArray[np.float64], free: Free) -> NDArray[np.float64]:
    """The path without the via points that a free straight line makes needless, the longest lines first."""
    for span in range(len(path) - 1, 1, -1):
        for first in range(len(path) - span):
            if edge_free(path[first], path[first + span], free):
                ends = path[: first + 1], path[first + span :]
                return np.concatenate(
                    [_shortcut(ends[0], free)[:-1], path[[first]], _shortcut(ends[1], free)]
                )
    return path
