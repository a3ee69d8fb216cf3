"""Exact distances of the pieces of two bodies that must keep apart (coal)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry.swept import Blocks, Floats, Indices, Mask, Swept

_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()
_NORMAL = _RESULT.normal  # a view: coal writes every normal to this place


@dataclass(frozen=True)
class Nearest:
    """The closest pair of pieces of two bodies."""

    distance_m: float  # negative: penetration depth
    a: str
    b: str
    at: tuple[int, int] = (0, 0)  # path positions


class Pair(NamedTuple):
    """Two pieces that must keep apart, where both masks hold."""

    a: int
    b: int
    rows: Mask  # (P,)
    columns: Mask  # (Q,)


def pairs_apart(a: Swept, b: Swept) -> Iterator[Pair]:
    """The pairs of pieces that must keep apart, with the positions at which they must."""
    when = _Apart(a, b)
    for i, x in enumerate(a.labels):
        for j, y in enumerate(b.labels):
            for rows, columns in when[x, y]:
                yield Pair(i, j, rows, columns)


class _Apart(dict[tuple[str, str], tuple[tuple[Mask, Mask], ...]]):
    """When the pieces of two links or objects must keep apart, worked out once for all pieces of both."""

    def __init__(self, a: Swept, b: Swept) -> None:
        super().__init__()
        self._bodies = a, b

    def __missing__(self, key: tuple[str, str]) -> tuple[tuple[Mask, Mask], ...]:
        found = self[key] = tuple(_apart(*self._bodies, *key))
        return found


def _apart(a: Swept, b: Swept, x: str, y: str) -> Iterator[tuple[Mask, Mask]]:
    """When pieces of a link or object `x` of `a` must keep apart from those of `y` of `b`."""
    everywhere_a, everywhere_b = np.ones(len(a), dtype=bool), np.ones(len(b), dtype=bool)
    rows, columns = everywhere_a, everywhere_b
    if x not in a.objects and y not in b.objects:
        yield rows, columns
        return
    if x in a.objects and y in b.objects:
        if x == y:
            return
        rows = ~a.rests.get(y, ~everywhere_a)
        columns = ~b.rests.get(x, ~everywhere_b)
        moves_a, moves_b = a.carried.get(x, ~everywhere_a), b.carried.get(y, ~everywhere_b)
        if (rows & moves_a).any():  # two things lying on the table are nobody's concern
            yield rows & moves_a, columns
        if (columns & moves_b).any():
            yield rows & ~moves_a, columns & moves_b
        return
    # Between two that hold one thing it is no obstacle: it goes with both of them.
    if y in b.objects:
        rows = ~(a.touches if x in a.gripper else a.holds).get(y, ~everywhere_a)
    if x in a.objects:
        columns = ~(b.touches if y in b.gripper else b.holds).get(x, ~everywhere_b)
    if rows.any() and columns.any():
        yield rows, columns


def look(x: Blocks, y: Blocks, todo: Indices, i: Indices, j: Indices) -> tuple[Floats, Floats, Floats]:
    """In the middles of blocks: (M,) exact distances, (M, 3) directions from a to b, nearest points of a."""
    distances, normals, points = (np.empty((len(todo), *side), np.float32) for side in ((), (3,), (3,)))
    looks = zip(*x.body.shapes(x.middle[todo[:, 1]], i), *y.body.shapes(y.middle[todo[:, 2]], j), strict=True)
    distance, clear, nearest_point = coal.distance, _RESULT.clear, _RESULT.getNearestPoint1
    for k, look in enumerate(looks):
        clear()
        distances[k] = distance(*look, _REQUEST, _RESULT)
        normals[k] = _NORMAL
        points[k] = nearest_point()
    return distances, normals, points


def nearest(a: Swept, b: Swept, at: NDArray[np.int64] | None = None) -> Nearest | None:
    """The smallest exact distance of the pairs that must keep apart, over cells `at` (T, 2).

    Without `at` over all cells. None when no pair has to keep apart there.
    """
    if at is None:
        at = np.stack(np.meshgrid(np.arange(len(a)), np.arange(len(b)), indexing="ij"), axis=-1).reshape(
            -1, 2
        )
    at = np.unique(at, axis=0)
    gaps = _spheres_apart_m(a, b, at)
    links_a, links_b = (
        np.array([label not in body.objects for label in body.labels], dtype=bool) for body in (a, b)
    )
    always, when = np.outer(links_a, links_b), _Apart(a, b)
    apply = np.broadcast_to(always, gaps.shape).copy()
    for i, j in np.argwhere(~always).tolist():
        for rows, columns in when[a.labels[i], b.labels[j]]:
            apply[:, i, j] |= rows[at[:, 0]] & columns[at[:, 1]]
    gaps[~apply] = np.inf
    if not np.isfinite(gaps.min(initial=np.inf)):
        return None

    def measured(k: int) -> Nearest:
        cell, x, y = (int(index) for index in np.unravel_index(k, gaps.shape))
        row, column = at[cell].tolist()
        return Nearest(_distance(a, b, row, column, x, y), a.labels[x], b.labels[y], (row, column))

    flat = gaps.ravel()
    best = measured(int(flat.argmin()))
    near = np.flatnonzero(flat < best.distance_m)  # few: sorting all of them took most of the time
    for k in near[np.argsort(flat[near], kind="stable")].tolist():
        if flat[k] >= best.distance_m:
            break
        best = min(best, measured(k), key=lambda found: found.distance_m)
    return best


def _spheres_apart_m(a: Swept, b: Swept, at: Indices) -> NDArray[np.float64]:
    """(T, La, Lb) between the spheres round all pieces, at cells `at` (T, 2); negative where they overlap."""
    x, y, z = np.moveaxis(a.centres[at[:, 0], :, None] - b.centres[at[:, 1], None], -1, 0)
    return np.sqrt(x * x + y * y + z * z) - (a.radii_m[:, None] + b.radii_m)


def overlap(a: Swept, b: Swept) -> Nearest | None:
    """The deepest overlap of two bodies at their first positions; None when they do not touch.

    Distance zero is contact: coal answers so where it cannot tell a touch from an overlap.
    """
    gaps = np.linalg.norm(a.centres[0, :, None] - b.centres[0], axis=-1) - a.radii_m[:, None] - b.radii_m
    near = np.argwhere(gaps <= 0)  # of a mark on the table, which has no pieces, there is nothing to touch
    when = _Apart(a, b)
    best: Nearest | None = None
    deepest = 0.0
    for k in np.argsort(gaps[*near.T], kind="stable"):
        i, j = near[k].tolist()
        if best is not None and gaps[i, j] >= deepest:
            break
        x, y = a.labels[i], b.labels[j]
        if any(rows[0] and columns[0] for rows, columns in when[x, y]):
            distance = _distance(a, b, 0, 0, i, j)
            if distance <= 0 and (best is None or distance < deepest):
                best, deepest = Nearest(distance, x, y), distance
    return best


def folded(body: Swept, pairs: Sequence[tuple[int, int]]) -> Mask:
    """(P,) True where two pieces of one body that may not touch (index pairs) overlap."""
    first, second = np.array(pairs).T
    gaps = np.linalg.norm(body.centres[:, first] - body.centres[:, second], axis=-1)  # (P, pairs)
    near = gaps < body.radii_m[first] + body.radii_m[second]
    hit = np.zeros(len(body), dtype=bool)
    for row, k in np.argwhere(near).tolist():
        hit[row] |= not hit[row] and _distance(body, body, row, row, *pairs[k]) < 0
    return hit


def _distance(a: Swept, b: Swept, row: int, column: int, i: int, j: int) -> float:
    _RESULT.clear()
    return coal.distance(
        a.pieces[i].shape, a.placed(row, i), b.pieces[j].shape, b.placed(column, j), _REQUEST, _RESULT
    )
