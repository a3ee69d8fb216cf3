"""Clearance: exact distances of bodies, and coordination diagrams.

The coordination diagram of two bodies along their paths marks the pairs of positions at which they are closer
than a margin. It is computed coarse to fine. One exact distance (coal), in the middle of a block of the
diagram, bounds the distance in the whole block: from below, because along its direction the two pieces
approach by no more than they move along it; from above, by the two nearest points carried along with the
pieces. Blocks that neither bound settles are split. Deep overlaps are found without a distance, by spheres
inside the pieces. Nothing is sampled: every cell is settled by a bound or exactly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rf_exp.geometry.swept import CORE_SPHERES, FINE_BLOCK, PARTS, Blocks, Floats, Indices, Mask, Swept

SLACK_M = 1e-4  # for coal's tolerance; in doubt, cells count as too close
NORMAL_ERROR_M = (
    2.5e-4  # gap along coal's direction may be smaller than its distance: 0.17 mm at most in 120,000
)
BLOCK = 32  # side of the initial blocks, in positions
HANDOVER_TOLERANCE_M = 1e-6  # tolerance between the release and the pick-up pose of a handed-over object
FORBID_TOLERANCE = (
    0.2  # cells with an upper bound below (1 + this) times the margin are forbidden, not refined
)

Pair = tuple[int, int, Mask, Mask]  # pieces that must keep apart where both masks, (P,) and (Q,), are True
Parts = tuple[Indices, Floats]  # (M, 3) open items, (M,) sort key in m, deepest first

_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()
_NORMAL = _RESULT.normal  # a view: coal writes every normal here


@dataclass(frozen=True)
class Nearest:
    """The closest pieces of two bodies, among those that must keep apart; infinite distance for none."""

    distance_m: float = np.inf  # negative: penetration depth
    a: str = ""
    b: str = ""
    at: tuple[int, int] = (0, 0)  # path positions


def _separation_masks(a: Swept, b: Swept) -> Callable[[str, str], list[tuple[Mask, Mask]]]:
    """Returns a function from labels of a and b to masks (P,), (Q,) of the cells in which they keep apart."""
    always_a, always_b = np.ones(len(a), dtype=bool), np.ones(len(b), dtype=bool)
    never_a, never_b = ~always_a, ~always_b

    @cache
    def masks_of(x: str, y: str) -> list[tuple[Mask, Mask]]:
        if x == y and x in a.objects and y in b.objects:
            return []
        if x in a.objects and y in b.objects:  # two objects at rest need not keep apart
            rows, columns = ~a.rests.get(y, never_a), ~b.rests.get(x, never_b)
            moves_a, moves_b = a.carried.get(x, never_a), b.carried.get(y, never_b)
            masks = [(rows & moves_a, columns)] if (rows & moves_a).any() else []
            masks += [(rows & ~moves_a, columns & moves_b)] if (columns & moves_b).any() else []
            return restricted(x, y, masks)
        # An object that both agents hold is no obstacle to either: it moves with both.
        rows, columns = always_a, always_b
        if y in b.objects:
            rows = ~(a.touches if x in a.gripper else a.holds).get(y, never_a)
        if x in a.objects:
            columns = ~(b.touches if y in b.gripper else b.holds).get(x, never_b)
        return restricted(x, y, [(rows, columns)] if rows.any() and columns.any() else [])

    def restricted(x: str, y: str, masks: list[tuple[Mask, Mask]]) -> list[tuple[Mask, Mask]]:
        """The parts restricted to cells in which handed-over objects are where the bodies have them."""
        for handed_over in (
            _handed_over(a, b, x),
            [(rows, columns) for columns, rows in _handed_over(b, a, y)],
        ):
            if handed_over:
                products = (
                    (rows & more_rows, columns & more_columns)
                    for rows, columns in masks
                    for more_rows, more_columns in handed_over
                )
                masks = [(rows, columns) for rows, columns in products if rows.any() and columns.any()]
        return masks

    return masks_of


def _handed_over(body: Swept, partner: Swept, name: str) -> list[tuple[Mask, Mask]]:
    """Masks of the cells in which an object that both bodies carry is where `body` has it; empty: all cells.

    An object that `partner` hands over is there only after its release, one that `body` hands over only until
    `partner` takes it.
    """
    carried, partner_carried = body.carried.get(name), partner.carried.get(name)
    if name not in body.objects or carried is None or partner_carried is None:
        return []
    positions, (first, last) = np.arange(len(body)), np.flatnonzero(carried)[[0, -1]]
    partner_positions, (partner_first, partner_last) = (
        np.arange(len(partner)),
        np.flatnonzero(partner_carried)[[0, -1]],
    )
    index, partner_index = body.labels.index(name), partner.labels.index(name)
    always = np.ones(len(partner), dtype=bool)
    if np.allclose(
        body.poses[last, index], partner.poses[partner_first, partner_index], atol=HANDOVER_TOLERANCE_M
    ):
        return [(positions <= last, always), (positions > last, partner_positions < partner_first)]
    if np.allclose(
        body.poses[first, index], partner.poses[partner_last, partner_index], atol=HANDOVER_TOLERANCE_M
    ):
        return [(positions >= first, always), (positions < first, partner_positions > partner_last)]
    return []


def must_keep_apart(a: Swept, b: Swept) -> Callable[[str, str], bool]:
    """Returns whether two labels, of a and of b, must keep apart at the first positions."""
    apart = _separation_masks(a, b)
    return lambda x, y: any(rows[0] and columns[0] for rows, columns in apart(x, y))


def exact_distances(
    x: Blocks, y: Blocks, todo: Indices, i: Indices, j: Indices
) -> tuple[Floats, Floats, Floats]:
    """Exact distances (M,), directions a to b (M, 3), nearest points of a (M, 3), in the block middles."""
    distances, normals, points = (np.empty((len(todo), *side), np.float32) for side in ((), (3,), (3,)))
    shape_pairs = zip(
        *x.body.shapes(x.middle[todo[:, 1]], i), *y.body.shapes(y.middle[todo[:, 2]], j), strict=True
    )
    distance, clear, nearest_point = coal.distance, _RESULT.clear, _RESULT.getNearestPoint1
    for k, shape_pair in enumerate(shape_pairs):
        clear()
        distances[k] = distance(*shape_pair, _REQUEST, _RESULT)
        normals[k] = _NORMAL
        points[k] = nearest_point()
    return distances, normals, points


def nearest(a: Swept, b: Swept, at: NDArray[np.int64] | None = None) -> Nearest:
    """The closest pieces that must keep apart, by exact distance, over cells `at` (T, 2) or all cells."""
    at = np.unique(np.argwhere(np.ones((len(a), len(b)))) if at is None else at, axis=0)
    centres_a, centres_b = (body.centres[at[:, k]].transpose(2, 1, 0) for k, body in enumerate((a, b)))
    x, y, z = centres_a[:, :, None] - centres_b[:, None]
    # (La, Lb, T) lower bounds, initially from bounding spheres; negative where these overlap
    gaps = np.sqrt(x * x + y * y + z * z) - (a.radii_m[:, None] + b.radii_m)[..., None]
    best = Nearest()
    if not gaps.size:
        return best
    apart = _separation_masks(a, b)

    @cache
    def exempt_cells(x: str, y: str) -> NDArray[np.int64]:
        """The cells in which two labels may touch."""
        masks = [rows[at[:, 0]] & columns[at[:, 1]] for rows, columns in apart(x, y)]
        return np.flatnonzero(~np.any(masks, axis=0)) if masks else np.arange(len(at))

    for i, x in enumerate(a.labels):
        for j, y in enumerate(b.labels):
            if (x in a.objects or y in b.objects) and len(exempt_cells(x, y)):  # links must always keep apart
                gaps[i, j, exempt_cells(x, y)] = np.inf
    moved_a, moved_b = (body.travelled_m[at[:, k]].T for k, body in enumerate((a, b)))  # (L, T)
    least = gaps.min(axis=2)
    while least.min() < best.distance_m:
        i, j = (int(index) for index in np.unravel_index(least.argmin(), least.shape))
        cell = int(gaps[i, j].argmin())
        row, column = at[cell].tolist()
        distance_m = exact_m(a, b, row, column, i, j)
        if distance_m < best.distance_m:
            best = Nearest(distance_m, a.labels[i], b.labels[j], (row, column))
        # The distance in one cell bounds that in all others, by the travel of both pieces in between.
        moved_m = np.abs(moved_a[i] - moved_a[i, cell]) + np.abs(moved_b[j] - moved_b[j, cell])
        np.maximum(gaps[i, j], distance_m - moved_m - SLACK_M - NORMAL_ERROR_M, out=gaps[i, j])
        gaps[i, j, cell] = np.inf
        least[i, j] = gaps[i, j].min()
    return best


def overlap(a: Swept, b: Swept) -> Nearest | None:
    """The deepest overlap of two bodies at their first positions; None when they do not touch.

    Distance zero is contact: coal returns it where it cannot distinguish a touch from an overlap.
    """
    closest = nearest(a, b, np.zeros((1, 2), dtype=int))
    return closest if closest.distance_m <= 0 else None


def self_collisions(body: Swept, pairs: Sequence[tuple[int, int]]) -> Mask:
    """Mask (P,), True where a pair of pieces of one body (index pairs) that must not touch overlaps."""
    first, second = np.array(pairs).T
    gaps = np.linalg.norm(body.centres[:, first] - body.centres[:, second], axis=-1)  # (P, pairs)
    near = gaps < body.radii_m[first] + body.radii_m[second]
    colliding = np.zeros(len(body), dtype=bool)
    for row, k in np.argwhere(near).tolist():
        colliding[row] |= not colliding[row] and exact_m(body, body, row, row, *pairs[k]) < 0
    return colliding


def exact_m(a: Swept, b: Swept, row: int, column: int, i: int, j: int) -> float:
    """The exact distance of piece i of a and piece j of b at path positions; negative: penetration depth."""
    _RESULT.clear()
    return coal.distance(
        a.pieces[i].shape,
        a.coal_transform(row, i),
        b.pieces[j].shape,
        b.coal_transform(column, j),
        _REQUEST,
        _RESULT,
    )


# coordination diagrams


def closer_than(a: Swept, b: Swept, margin_m: float, *, between: bool = True) -> Mask:
    """The coordination diagram (P, Q): True where the bodies are closer than the margin.

    With `between`, half of the motion of both bodies to the neighbouring positions is added to the
    margin of a cell. Two free neighbours then prove that the motion between them keeps the margin as
    well: along it the distance is at least (d0 + d1 - moved) / 2.

    Free cells keep the required distance. Forbidden cells do not, or exceed it by less than
    `FORBID_TOLERANCE` times the margin.
    """
    apart = _separation_masks(a, b)
    pairs = [
        (i, j, rows, columns)
        for i, j in _near(a, b, margin_m, between)
        for rows, columns in apart(a.labels[i], b.labels[j])
    ]
    if not pairs:
        return np.zeros((len(a), len(b)), dtype=bool)
    diagram = _Diagram(a, b, pairs, margin_m)
    size = min(BLOCK, 1 << (max(len(a), len(b)) - 1).bit_length())
    todo = diagram.initial_items(a.blocks(size, between), b.blocks(size, between))
    while len(todo):
        x, y = a.blocks(size, between), b.blocks(size, between)
        if size == FINE_BLOCK:
            diagram.forbid_by_cores(todo, x, y)
        first = np.zeros(len(todo), dtype=bool)
        first[np.unique(todo[:, 1] * len(y) + todo[:, 2], return_index=True)[1]] = True
        still_open = []
        for items in (todo[first], todo[~first]):  # the first pair of a block may settle all of it
            items = diagram.open_blocks(items, x, y)
            if len(items):
                still_open.append(diagram.settle(items, x, y))
        if not still_open:
            break
        todo, gap = (np.concatenate(arrays) for arrays in zip(*still_open, strict=True))
        todo = todo[np.argsort(gap, kind="stable")]
        size //= min(PARTS, size)
    return diagram.forbidden[: len(a), : len(b)]


def _near(a: Swept, b: Swept, margin_m: float, between: bool) -> list[list[int]]:
    """Pairs [i, j] of pieces that may forbid a cell. All pairs where both bodies move: blocks are faster."""
    if min(len(a), len(b)) > 1:
        return [[i, j] for i in range(len(a.pieces)) for j in range(len(b.pieces))]
    if not (a.pieces and b.pieces):
        return []
    added_m = [body.stride_m / 2 if between and len(body) > 1 else 0.0 for body in (a, b)]
    gaps = cdist(a.centres.reshape(-1, 3), b.centres.reshape(-1, 3))
    gaps = gaps.reshape(len(a), len(a.pieces), len(b), len(b.pieces))
    gaps -= (a.radii_m + added_m[0])[..., None, None]  # (P, La) or (La,)
    gaps -= b.radii_m + added_m[1]  # (Q, Lb) or (Lb,)
    least = gaps.min(axis=(0, 2))
    return np.argwhere(least < (1 + FORBID_TOLERANCE) * margin_m + SLACK_M).tolist()


class _Diagram:
    """Coordination diagram under construction. Open items `todo` (M, 3): pair, block row, block column."""

    def __init__(self, a: Swept, b: Swept, pairs: Sequence[Pair], margin_m: float) -> None:
        self.margin_m = margin_m
        pieces_a, pieces_b, in_rows, in_columns = zip(*pairs, strict=True)
        self.a, self.b = np.array(pieces_a), np.array(pieces_b)
        rows, columns = (-(-len(body) // BLOCK) * BLOCK for body in (a, b))
        self.rows = np.zeros((len(pairs), rows), dtype=bool)
        self.columns = np.zeros((len(pairs), columns), dtype=bool)
        self.rows[:, : len(a)] = in_rows
        self.columns[:, : len(b)] = in_columns
        self.forbidden = np.ones((rows, columns), dtype=bool)  # padding beyond the ends is settled
        self.forbidden[: len(a), : len(b)] = False

    def initial_items(self, x: Blocks, y: Blocks) -> Indices:
        """Open items whose bounding spheres, and covers along the line of centres, are within the margin."""
        gaps = cdist(x.centres.reshape(-1, 3), y.centres.reshape(-1, 3))
        gaps -= x.reach_m.reshape(-1, 1) + y.reach_m.reshape(-1)
        gaps = gaps.reshape(len(x), len(x.body.pieces), len(y), len(y.body.pieces))
        gaps = gaps.transpose(1, 3, 0, 2)[self.a, self.b]
        rows = np.logical_or.reduceat(self.rows, x.rows[:, 0], axis=1)
        columns = np.logical_or.reduceat(self.columns, y.rows[:, 0], axis=1)
        todo = np.argwhere((gaps < self.margin_m) & rows[:, :, None] & columns[:, None])
        if not len(todo):
            return todo
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        line = y.centres[c, j] - x.centres[r, i]
        length_m = np.maximum(np.linalg.norm(line, axis=1, keepdims=True), SLACK_M)
        normal = (line / length_m).astype(np.float32)
        (centres_a, radii_a), (centres_b, radii_b) = x.cover, y.cover
        far_a = ((centres_a[r, i] @ normal[:, :, None])[..., 0] + radii_a[i]).max(axis=1)
        near_b = ((centres_b[c, j] @ normal[:, :, None])[..., 0] - radii_b[j]).min(axis=1)
        advance = x.approach_bound_m(i, r, normal).max(axis=1) + y.approach_bound_m(j, c, -normal).max(axis=1)
        near = np.flatnonzero(near_b - far_a - advance < self.margin_m)
        return todo[near[np.argsort(gaps[pair[near], r[near], c[near]], kind="stable")]]

    def open_blocks(self, todo: Indices, x: Blocks, y: Blocks) -> Indices:
        """The items with a cell that is not forbidden yet."""
        return todo[~self._cells(todo, x, y).all(axis=(1, 2))]

    def forbid_by_cores(self, todo: Indices, x: Blocks, y: Blocks) -> None:
        """Forbids cells in which inner spheres of the pieces are too close; most need no distance then."""
        todo = self.open_blocks(todo, x, y)
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        radii = x.core_m[i][:, :, None] + y.core_m[j][:, None]  # (M, K, K)
        line = x.core_middle[i, r][:, :, None] - y.core_middle[j, c][:, None]
        depth = radii - np.sqrt(np.einsum("mkli,mkli->mkl", line, line))
        deepest = depth.reshape(len(todo), CORE_SPHERES**2).argmax(axis=1)
        k, m = np.divmod(deepest, CORE_SPHERES)
        upper_m = (
            _point_distances_m(x.core[i, k, r], y.core[j, m, c])
            - radii[np.arange(len(todo)), k, m][:, None, None]
        )
        upper_m -= x.added_motion_m[i, r][:, :, None] + y.added_motion_m[j, c][:, None]
        self._forbid(todo, (upper_m < self.margin_m) & self._must_separate(todo, x.size, y.size))

    def settle(self, todo: Indices, x: Blocks, y: Blocks) -> Parts:
        """Settles parts of blocks, or cells of fine blocks, by bounds; returns the parts that stay open."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        distance, normal, point_a = exact_distances(x, y, todo, i, j)
        # bounds on the distance of the pieces, less the added motion
        advance = x.approach_bound_m(i, r, normal)[:, :, None] + y.approach_bound_m(j, c, -normal)[:, None]
        lower_m = distance[:, None, None] - advance
        upper_m = distance[:, None, None] + x.surplus_m[i, r][:, :, None] + y.surplus_m[j, c][:, None]
        open_ = ~(lower_m >= self.margin_m + NORMAL_ERROR_M)
        if not (x.fine and y.fine):
            too_close = upper_m < self.margin_m - SLACK_M
            parts, _ = _parts(todo, too_close, upper_m, x, y)
            self._forbid(parts, self._must_separate(parts, x.size // x.parts, y.size // y.parts))
            return _parts(todo, open_ & ~too_close, lower_m + upper_m, x, y)
        upper_m = np.fmin(upper_m, self._carried_m(todo, x, y, distance, normal, point_a))
        if x.size == y.size == 1:  # exact, also where coal returns no direction
            open_ = ~(upper_m >= self.margin_m + SLACK_M)
        open_ &= self._must_separate(todo, x.size, y.size)
        self._forbid(todo, open_ & (upper_m < self.margin_m + max(SLACK_M, FORBID_TOLERANCE * self.margin_m)))
        open_ &= ~self._cells(todo, x, y)
        return _parts(todo, open_, lower_m + upper_m, x, y)

    def _carried_m(
        self, todo: Indices, x: Blocks, y: Blocks, distance: Floats, normal: Floats, point_a: Floats
    ) -> Floats:
        """Distances (M, S, S) of the nearest points, carried with their pieces, less the added motion."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        inside = np.minimum(distance, 0)[:, None] / 2  # for an overlap: a point of both pieces
        points_a = x.carried_points(i, r, point_a + inside * normal)
        points_b = y.carried_points(j, c, point_a + (distance[:, None] - inside) * normal)
        return (
            _point_distances_m(points_a, points_b)
            - x.added_motion_m[i, r][:, :, None]
            - y.added_motion_m[j, c][:, None]
        )

    def _cells(self, todo: Indices, x: Blocks, y: Blocks) -> Mask:
        """Mask (M, S, S) of the cells of the blocks that are forbidden so far."""
        blocks = self.forbidden.reshape(-1, x.size, self.forbidden.shape[1] // y.size, y.size)
        return blocks[todo[:, 1], :, todo[:, 2]]

    def _must_separate(self, todo: Indices, height: int, width: int) -> Mask:
        """Mask (M, height, width) of the cells of blocks in which their pair of pieces must keep apart."""
        pair, r, c = todo.T
        rows = self.rows.reshape(len(self.rows), -1, height)[pair, r]
        columns = self.columns.reshape(len(self.columns), -1, width)[pair, c]
        return rows[:, :, None] & columns[:, None]

    def _forbid(self, todo: Indices, closer: Mask) -> None:
        """Forbids cells (M, height, width) of blocks."""
        k, row, column = np.nonzero(closer)
        _, height, width = closer.shape
        self.forbidden[todo[k, 1] * height + row, todo[k, 2] * width + column] = True


def _parts(todo: Indices, open_: Mask, gap: Floats, x: Blocks, y: Blocks) -> Parts:
    """The parts of blocks in which `open_` (M, bounds, bounds) is True, and their gaps."""
    height, width = x.bounds // x.parts, y.bounds // y.parts
    parts = np.zeros((len(todo), x.parts, y.parts), dtype=bool)
    k, row, column = np.nonzero(open_)
    parts[k, row // height, column // width] = True
    k, row, column = np.nonzero(parts)
    gaps = gap[:, (height - 1) // 2 :: height, (width - 1) // 2 :: width]
    pair, r, c = todo[k].T
    return np.stack([pair, r * x.parts + row, c * y.parts + column], axis=1), gaps[k, row, column]


def _point_distances_m(a: Floats, b: Floats) -> Floats:
    """Distances (M, S, S) of points (M, 3, S)."""
    origin = a[:, :, :1]
    a, b = a - origin, b - origin
    squared = -2 * a.swapaxes(1, 2) @ b
    squared += np.einsum("mis,mis->ms", a, a)[:, :, None] + np.einsum("mis,mis->ms", b, b)[:, None]
    return np.sqrt(np.maximum(squared, 0))
