"""Exact distances of the pieces of two bodies that must keep apart (coal)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rf_exp.geometry.swept import Blocks, Floats, Indices, Mask, Swept

SLACK_M = 1e-4  # for coal's tolerance; doubt counts as too close
ASKEW_M = 2.5e-4  # pieces are nearer along coal's direction than its distance: of 120,000 by 0.17 mm at most

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
        self._a, self._b = a, b
        self._everywhere = np.ones(len(a), dtype=bool), np.ones(len(b), dtype=bool)
        self._nowhere = np.zeros(len(a), dtype=bool), np.zeros(len(b), dtype=bool)

    def __missing__(self, key: tuple[str, str]) -> tuple[tuple[Mask, Mask], ...]:
        found = self[key] = tuple(self._when(*key))
        return found

    def _when(self, x: str, y: str) -> Iterator[tuple[Mask, Mask]]:
        """When pieces of a link or object `x` of one body must keep apart from those of `y` of the other."""
        a, b = self._a, self._b
        rows, columns = self._everywhere
        if x not in a.objects and y not in b.objects:
            yield rows, columns
            return
        never_a, never_b = self._nowhere
        if x in a.objects and y in b.objects:
            if x == y:
                return
            rows, columns = ~a.rests.get(y, never_a), ~b.rests.get(x, never_b)
            moves_a, moves_b = a.carried.get(x, never_a), b.carried.get(y, never_b)
            if (rows & moves_a).any():  # two things lying on the table are nobody's concern
                yield rows & moves_a, columns
            if (columns & moves_b).any():
                yield rows & ~moves_a, columns & moves_b
            return
        # Between two that hold one thing it is no obstacle: it goes with both of them.
        if y in b.objects:
            rows = ~(a.touches if x in a.gripper else a.holds).get(y, never_a)
        if x in a.objects:
            columns = ~(b.touches if y in b.gripper else b.holds).get(x, never_b)
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
    if not gaps.size:
        return None
    when = _Apart(a, b)

    @cache
    def idle(x: str, y: str) -> NDArray[np.int64]:
        """The cells at which they may touch."""
        apply = [rows[at[:, 0]] & columns[at[:, 1]] for rows, columns in when[x, y]]
        return np.flatnonzero(~np.any(apply, axis=0)) if apply else np.arange(len(at))

    for i, x in enumerate(a.labels):
        for j, y in enumerate(b.labels):
            if (x in a.objects or y in b.objects) and len(idle(x, y)):  # links must always keep apart
                gaps[i, j, idle(x, y)] = np.inf
    return _nearest(a, b, at, gaps)


def _nearest(a: Swept, b: Swept, at: Indices, apart_m: NDArray[np.float64]) -> Nearest | None:
    """`nearest` of pieces that are at least `apart_m` (La, Lb, T) from one another; infinite: no matter.

    What is known of two pieces at one cell bounds them at all others, by how far they move until there.
    """
    moved_a, moved_b = (body.travelled_m[at[:, k]].T for k, body in enumerate((a, b)))  # (L, T)
    least = apart_m.min(axis=2)
    best: Nearest | None = None
    while least.min() < (best.distance_m if best else np.inf):
        i, j = (int(index) for index in np.unravel_index(least.argmin(), least.shape))
        cell = int(apart_m[i, j].argmin())
        row, column = at[cell].tolist()
        distance_m = _distance(a, b, row, column, i, j)
        if best is None or distance_m < best.distance_m:
            best = Nearest(distance_m, a.labels[i], b.labels[j], (row, column))
        moved_m = np.abs(moved_a[i] - moved_a[i, cell]) + np.abs(moved_b[j] - moved_b[j, cell])
        np.maximum(apart_m[i, j], distance_m - moved_m - SLACK_M - ASKEW_M, out=apart_m[i, j])
        apart_m[i, j, cell] = np.inf
        least[i, j] = apart_m[i, j].min()
    return best


def _spheres_apart_m(a: Swept, b: Swept, at: Indices) -> NDArray[np.float64]:
    """(La, Lb, T) between the spheres round all pieces at cells (T, 2); negative where they overlap."""
    centres_a, centres_b = (body.centres[at[:, k]].transpose(2, 1, 0) for k, body in enumerate((a, b)))
    x, y, z = centres_a[:, :, None] - centres_b[:, None]
    return np.sqrt(x * x + y * y + z * z) - (a.radii_m[:, None] + b.radii_m)[..., None]


def overlap(a: Swept, b: Swept) -> Nearest | None:
    """The deepest overlap of two bodies at their first positions; None when they do not touch.

    Distance zero is contact: coal answers so where it cannot tell a touch from an overlap.
    """
    gaps = cdist(a.centres[0], b.centres[0]) - a.radii_m[:, None] - b.radii_m
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
