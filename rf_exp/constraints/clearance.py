"""Exact clearance between bodies that move along paths.

A body is a set of convex pieces with a pose at every path position. The answer for two bodies is
their coordination diagram: which pairs of positions come closer than a margin. It is found coarse
to fine. One exact distance (coal) in the middle of a block of the diagram says far more than its one
cell. Along the direction of that distance the two pieces stay apart in every cell where their extents
do, and the two nearest points, carried along with the pieces, never are nearer than the pieces. What
neither bound settles is split. Nothing is sampled away: every cell is settled by a bound or exactly.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rf_exp.constraints.shapes import Piece

BLOCK = 32  # positions on the side of the first blocks
FINE_BLOCK = 8  # from this size on, every cell of a block has its own bounds
SLACK_M = 1e-4  # for coal's tolerance; doubt counts as too close
DOUBT = 0.2  # of the margin: a cell whose bounds are this near to what it has to keep is not looked at again
BATCH = 512  # rows of a product that stay in the cache

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Quarters = tuple[Indices, NDArray[np.float64]]  # (M, 3) what is to do, (M,) m the deeper the sooner

_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()


@dataclass(frozen=True)
class Nearest:
    """The closest pair of pieces of two bodies."""

    distance_m: float  # negative: penetration depth
    a: str
    b: str
    at: tuple[int, int] = (0, 0)  # path positions


@dataclass(frozen=True, eq=False)
class Swept:
    """Convex pieces of one body at P path positions, world frame."""

    pieces: tuple[Piece, ...]
    labels: tuple[str, ...]  # (L,) link or object that each piece belongs to
    poses: NDArray[np.float64]  # (P, L, 4, 4) world_from_piece
    objects: frozenset[str] = frozenset()  # the labels that are objects
    carried: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) it moves with the hand
    touches: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) the gripper may touch it
    rests: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) what is carried may touch it
    holds: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) it is in the gripper
    gripper: frozenset[str] = frozenset()  # the labels that may touch

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def radii_m(self) -> NDArray[np.float64]:
        """(L,) of the sphere round each piece."""
        return np.array([piece.radius_m for piece in self.pieces])

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """(P, L, 3) of the sphere round each piece."""
        local = np.array([piece.centre for piece in self.pieces]).reshape(-1, 3)
        return np.einsum("plij,lj->pli", self.poses[..., :3, :3], local) + self.poses[..., :3, 3]

    @cached_property
    def step_m(self) -> NDArray[np.float64]:
        """(P - 1, L) bound on how far any point of a piece moves from one position to the next."""
        delta = np.diff(self.poses, axis=0)
        local = np.array([piece.corners for piece in self.pieces])
        moved = local @ delta[..., :3, :3].swapaxes(2, 3) + delta[..., None, :3, 3]
        return np.sqrt(np.max(np.sum(moved**2, axis=-1), axis=-1))

    @cached_property
    def travelled_m(self) -> NDArray[np.float64]:
        """(P, L) the sum of `step_m` up to each position."""
        return np.concatenate([np.zeros((1, len(self.pieces))), np.cumsum(self.step_m, axis=0)])

    @cached_property
    def turned_m(self) -> NDArray[np.float64]:
        """(P, L) as `travelled_m`, with the centre of the sphere round the piece held still."""
        delta = np.diff(self.poses[..., :3, :3], axis=0)
        step = np.sqrt(np.sum(delta**2, axis=(2, 3)) / 2) * self.radii_m  # |R - 1| is 1/sqrt(2) of Frobenius'
        return np.concatenate([np.zeros((1, len(self.pieces))), np.cumsum(step, axis=0)])

    @cached_property
    def stride_m(self) -> NDArray[np.float64]:
        """(P, L) the longer one of the two steps beside each position."""
        step = self.step_m
        edge = np.zeros((1, len(self.pieces)))
        return np.maximum(np.concatenate([edge, step]), np.concatenate([step, edge]))

    @cached_property
    def _placed(self) -> dict[tuple[int, int], coal.Transform3s]:
        return {}

    @cached_property
    def _cuts(self) -> dict[tuple[int, bool], "_Blocks"]:
        return {}

    def blocks(self, size: int, between: bool) -> "_Blocks":
        """The positions cut into blocks of a size (a power of two); a single one is a block of one."""
        key = size if len(self) > 1 else 1, between
        found = self._cuts.get(key)
        if found is None:
            found = self._cuts[key] = _Blocks(self, *key)
        return found

    def placed(self, position: int, piece: int) -> coal.Transform3s:
        """coal's transform of a piece."""
        key = (position, piece)
        found = self._placed.get(key)
        if found is None:
            pose = self.poses[position, piece]
            found = self._placed[key] = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        return found


class _Blocks:
    """A body cut into B blocks of S path positions; the last one is filled up with the last position."""

    def __init__(self, body: Swept, size: int, between: bool) -> None:
        self.body, self.size = body, size
        self.halves = 2 if size > 1 else 1
        begin = np.arange(0, len(body), size)
        self.rows = np.minimum(begin[:, None] + np.arange(size), len(body) - 1)  # (B, S)
        self.middle = (self.rows[:, 0] + self.rows[:, -1]) // 2
        self.need_m = self._spread(body.stride_m / 2 if between else np.zeros_like(body.stride_m))
        self.travel_m = self._from_middle(body.travelled_m)  # (L, B, S), as everything that is spread

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """(B, L, 3) in the middles of the blocks."""
        return self.body.centres[self.middle]

    @cached_property
    def reach_m(self) -> NDArray[np.float64]:
        """(B, L) of the sphere round all that a piece sweeps and has to keep free in a block."""
        away = np.linalg.norm(self.body.centres[self.rows] - self.centres[:, None], axis=-1).max(axis=1)
        return away + self.body.radii_m + self.need_m.max(axis=2).T

    @cached_property
    def cover(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(B, L, K, 3) and (L, K) m: the spheres that cover the pieces in the middles of the blocks."""
        local = np.array([piece.cover for piece in self.body.pieces])
        poses = self.body.poses[self.middle]
        return local[..., :3] @ poses[..., :3, :3].swapaxes(2, 3) + poses[..., None, :3, 3], local[..., 3]

    @cached_property
    def _shift(self) -> NDArray[np.float64]:
        """(L, B, S, 3) of the centre since the middle."""
        return self._spread(self.body.centres) - self.centres.swapaxes(0, 1)[:, :, None]

    @cached_property
    def _turn_and_need_m(self) -> NDArray[np.float64]:
        return self._from_middle(self.body.turned_m) + self.need_m

    @cached_property
    def _rotation(self) -> NDArray[np.float64]:
        return self._spread(self.body.poses[..., :3, :3])

    @cached_property
    def _origin(self) -> NDArray[np.float64]:
        return self._spread(self.body.poses[..., :3, 3])

    @cached_property
    def surplus_m(self) -> NDArray[np.float64]:
        """(L, B, halves) the most that a piece travels beyond what it has to keep free."""
        return _halves_max(self.travel_m - self.need_m, self.halves)

    @cached_property
    def _transforms(self) -> list[coal.Transform3s | None]:
        return [None] * (len(self) * len(self.body.pieces))

    def _spread(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(P, L, ...) to (L, B, S, ...)."""
        return np.ascontiguousarray(np.moveaxis(values[self.rows], 2, 0))

    def _from_middle(self, travelled_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(self._spread(travelled_m) - travelled_m[self.middle].T[:, :, None])

    def advance_m(self, piece: Indices, block: Indices, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, halves) how far pieces may come along normals (M, 3), with what they keep free."""
        along = (self._shift[piece, block] @ normal[:, :, None])[..., 0]
        return _halves_max(along + self._turn_and_need_m[piece, block], self.halves)

    def extent_m(self, piece: Indices, block: Indices, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, S) how far pieces reach along a normal (M, 3) from the world's origin."""
        farthest = np.einsum("msi,mi->ms", self._origin[piece, block], normal)
        local = np.einsum("msij,mi->msj", self._rotation[piece, block], normal).astype(np.float32)
        order = np.argsort(piece, kind="stable")
        ends = np.searchsorted(piece[order], np.arange(len(self.body.pieces) + 1)).tolist()
        step = max(1, BATCH // self.size)
        for each, begin, end in zip(self.body.pieces, ends[:-1], ends[1:], strict=True):
            for first in range(begin, end, step):
                some = order[first : min(first + step, end)]
                heights = each.hull @ local[some].reshape(-1, 3).T
                farthest[some] += heights.max(axis=0).reshape(-1, self.size)
        return farthest

    def carry(self, piece: Indices, block: Indices, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, S, 3) where world points (M, 3) of pieces in the middles go."""
        pose = self.body.poses[self.middle[block], piece]
        local = np.einsum("mij,mi->mj", pose[:, :3, :3], point - pose[:, :3, 3])
        turned = np.einsum("msij,mj->msi", self._rotation[piece, block], local)
        return turned + self._origin[piece, block]

    def placed(self, piece: Indices, block: Indices) -> list[coal.Transform3s]:
        """coal's transforms in the middles of the blocks."""
        found, pieces = [], len(self.body.pieces)
        for key in (block * pieces + piece).tolist():
            transform = self._transforms[key]
            if transform is None:
                at, which = divmod(key, pieces)
                transform = self._transforms[key] = self.body.placed(int(self.middle[at]), which)
            found.append(transform)
        return found


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two pieces that must keep apart, where both masks hold."""

    a: int
    b: int
    rows: Mask  # (P,)
    columns: Mask  # (Q,)


def _pairs(a: Swept, b: Swept) -> Iterator[_Pair]:
    """The pairs of pieces that must keep apart, with the positions at which they must."""
    everywhere_a, everywhere_b = np.ones(len(a), dtype=bool), np.ones(len(b), dtype=bool)
    for i, x in enumerate(a.labels):
        for j, y in enumerate(b.labels):
            rows, columns = everywhere_a, everywhere_b
            if x in a.objects and y in b.objects:
                if x == y:
                    continue
                rows = ~a.rests.get(y, ~everywhere_a)
                columns = ~b.rests.get(x, ~everywhere_b)
                moves_a, moves_b = a.carried.get(x, ~everywhere_a), b.carried.get(y, ~everywhere_b)
                if (rows & moves_a).any():  # two things lying on the table are nobody's concern
                    yield _Pair(i, j, rows & moves_a, columns)
                if (columns & moves_b).any():
                    yield _Pair(i, j, rows & ~moves_a, columns & moves_b)
                continue
            # Between two that hold one thing it is no obstacle: it goes with both of them.
            if y in b.objects:
                rows = ~(a.touches if x in a.gripper else a.holds).get(y, ~everywhere_a)
            if x in a.objects:
                columns = ~(b.touches if y in b.gripper else b.holds).get(x, ~everywhere_b)
            if (rows is everywhere_a or rows.any()) and (columns is everywhere_b or columns.any()):
                yield _Pair(i, j, rows, columns)


def closer_than(a: Swept, b: Swept, margin_m: float, *, between: bool = True) -> Mask:
    """The coordination diagram (P, Q): True where the bodies come closer than the margin.

    With `between`, a cell also keeps half of what both bodies move to the neighbouring positions
    free. Two free neighbours then prove that the motion between them keeps the margin as well:
    along it the distance is at least (d0 + d1 - moved) / 2.

    A free cell keeps all of that. A forbidden one lacks some of it, or has less than `DOUBT` of the margin
    to spare.
    """
    pairs = tuple(_pairs(a, b))
    if not pairs:
        return np.zeros((len(a), len(b)), dtype=bool)
    diagram = _Diagram(a, b, pairs, margin_m)
    size = min(BLOCK, _power_of_two(max(len(a), len(b))))
    todo = diagram.meeting(a.blocks(size, between), b.blocks(size, between))
    while len(todo):
        x, y = a.blocks(size, between), b.blocks(size, between)
        left = []
        for some in _first_of_each_block(todo, len(y)):
            some = diagram.open_blocks(some, x, y)
            if len(some):
                left.append((diagram.by_block if size > FINE_BLOCK else diagram.by_cell)(some, x, y))
        if not left:
            break
        todo, gap = (np.concatenate(each) for each in zip(*left, strict=True))
        todo = todo[np.argsort(gap, kind="stable")]
        size //= 2
    return diagram.forbidden[: len(a), : len(b)]


class _Diagram:
    """A diagram in the making. What is to do: (M, 3) pair of pieces, block of rows, block of columns."""

    def __init__(self, a: Swept, b: Swept, pairs: Sequence[_Pair], margin_m: float) -> None:
        self.margin_m = margin_m
        self.a, self.b = np.array([pair.a for pair in pairs]), np.array([pair.b for pair in pairs])
        self.rows = np.array([pair.rows for pair in pairs])  # (pairs, P)
        self.columns = np.array([pair.columns for pair in pairs])  # (pairs, Q)
        sides = [-(-len(body) // BLOCK) * BLOCK for body in (a, b)]
        self.forbidden = np.ones(sides, dtype=bool)  # beyond the ends nothing is left to find
        self.forbidden[: len(a), : len(b)] = False

    def meeting(self, x: _Blocks, y: _Blocks) -> Indices:
        """Where the spheres round pieces meet, and those that cover them along the line of their centres."""
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
        normal = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), SLACK_M)
        (centres_a, radii_a), (centres_b, radii_b) = x.cover, y.cover
        far_a = ((centres_a[r, i] @ normal[:, :, None])[..., 0] + radii_a[i]).max(axis=1)
        near_b = ((centres_b[c, j] @ normal[:, :, None])[..., 0] - radii_b[j]).min(axis=1)
        advance = x.advance_m(i, r, normal).max(axis=1) + y.advance_m(j, c, -normal).max(axis=1)
        near = np.flatnonzero(near_b - far_a - advance < self.margin_m)
        return todo[near[np.argsort(gaps[pair[near], r[near], c[near]], kind="stable")]]

    def open_blocks(self, todo: Indices, x: _Blocks, y: _Blocks) -> Indices:
        """What is not forbidden altogether."""
        rows, columns = self.forbidden.shape
        full = np.all(self.forbidden.reshape(-1, x.size, columns), axis=1)
        full = np.all(full.reshape(rows // x.size, -1, y.size), axis=2)
        return todo[~full[todo[:, 1], todo[:, 2]]]

    def by_block(self, todo: Indices, x: _Blocks, y: _Blocks) -> Quarters:
        """Settles quarters of blocks by one bound on how the pieces move; returns those that stay open."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        distance, normal, _ = _look(x, y, todo, i, j)
        least = (
            distance[:, None, None]
            - x.advance_m(i, r, normal)[:, :, None]
            - y.advance_m(j, c, -normal)[:, None]
        )
        most = distance[:, None, None] + x.surplus_m[i, r][:, :, None] + y.surplus_m[j, c][:, None]
        closer = most < self.margin_m - SLACK_M
        for k, half, other in np.argwhere(closer).tolist():
            top, left = r[k] * x.size + half * x.size // x.halves, c[k] * y.size + other * y.size // y.halves
            rows = slice(top, min(top + x.size // x.halves, len(x.body)))
            columns = slice(left, min(left + y.size // y.halves, len(y.body)))
            both = self.rows[pair[k], rows, None] & self.columns[pair[k], None, columns]
            self.forbidden[rows, columns] |= both
        return _quarters(todo, ~closer & ~(least >= self.margin_m + SLACK_M), least + most, x, y)

    def by_cell(self, todo: Indices, x: _Blocks, y: _Blocks) -> Quarters:
        """Settles cells by bounds of their own; returns the quarters of blocks in which some stay open."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        distance, normal, point_a = _look(x, y, todo, i, j)
        keep = self.margin_m + x.need_m[i, r][:, :, None] + y.need_m[j, c][:, None]  # (M, S, S)
        least = -y.extent_m(j, c, -normal)[:, None] - x.extent_m(i, r, normal)[:, :, None]
        if x.size == y.size == 1:
            least = np.fmax(least, distance[:, None, None])
        most = distance[:, None, None] + x.travel_m[i, r][:, :, None] + y.travel_m[j, c][:, None]
        inside = np.minimum(distance, 0.0)[:, None] / 2  # where pieces overlap: a point of both
        points_a = x.carry(i, r, point_a + inside * normal) - point_a[:, None]
        points_b = y.carry(j, c, point_a + (distance[:, None] - inside) * normal) - point_a[:, None]
        squared = np.sum(points_a**2, axis=2)[:, :, None] + np.sum(points_b**2, axis=2)[:, None]
        squared -= 2 * points_a @ points_b.swapaxes(1, 2)
        most = np.fmin(most, np.sqrt(np.maximum(squared, 0.0)))

        rows, columns = x.rows[r][:, :, None], y.rows[c][:, None]
        concerned = self.rows[pair[:, None, None], rows] & self.columns[pair[:, None, None], columns]
        concerned &= ~(least >= keep + SLACK_M)  # also where coal has no direction to give
        k, row, column = np.nonzero(concerned & (most < keep + max(SLACK_M, DOUBT * self.margin_m)))
        self.forbidden[rows[k, row, 0], columns[k, 0, column]] = True
        if x.size == y.size == 1:
            return todo[:0], np.zeros(0)
        concerned &= ~self.forbidden[rows, columns]
        quarters = len(todo), x.halves, x.size // x.halves, y.halves, y.size // y.halves
        open_ = np.any(concerned.reshape(quarters), axis=(2, 4))
        gap = (least + most - keep).reshape(quarters).mean(axis=(2, 4))
        return _quarters(todo, open_, gap, x, y)


def _first_of_each_block(todo: Indices, columns: int) -> tuple[Indices, Indices]:
    """The first pair of every block, which may well settle it for the others too, and the others."""
    first = np.zeros(len(todo), dtype=bool)
    first[np.unique(todo[:, 1] * columns + todo[:, 2], return_index=True)[1]] = True
    return todo[first], todo[~first]


def _quarters(todo: Indices, open_: Mask, gap: NDArray[np.float64], x: _Blocks, y: _Blocks) -> Quarters:
    """The blocks of half the size for which `open_` (M, halves, halves) is set, and their gaps."""
    k, half, other = np.nonzero(open_)
    quarters = todo[k] * [1, x.halves, y.halves] + np.stack([0 * k, half, other], axis=1)
    return quarters, gap[k, half, other]


def _halves_max(values: NDArray[np.float64], halves: int) -> NDArray[np.float64]:
    """(..., S) to (..., halves)."""
    return values.reshape(*values.shape[:-1], halves, values.shape[-1] // halves).max(axis=-1)


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()


def _look(
    x: _Blocks, y: _Blocks, todo: Indices, i: Indices, j: Indices
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """In the middles of blocks: (M,) exact distances, (M, 3) directions from a to b, nearest points of a."""
    distances, normals, points = np.empty(len(todo)), np.empty((len(todo), 3)), np.empty((len(todo), 3))
    shapes_a = [piece.shape for piece in x.body.pieces]
    shapes_b = [piece.shape for piece in y.body.pieces]
    placed = x.placed(i, todo[:, 1]), y.placed(j, todo[:, 2])
    distance, clear, nearest_point = coal.distance, _RESULT.clear, _RESULT.getNearestPoint1
    for k, (p, at_a, q, at_b) in enumerate(zip(i.tolist(), placed[0], j.tolist(), placed[1], strict=True)):
        clear()
        distances[k] = distance(shapes_a[p], at_a, shapes_b[q], at_b, _REQUEST, _RESULT)
        normals[k] = _RESULT.normal
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
    gaps = np.linalg.norm(a.centres[at[:, 0], :, None] - b.centres[at[:, 1], None], axis=-1)  # (T, La, Lb)
    gaps -= a.radii_m[:, None] + b.radii_m
    apply = np.zeros(gaps.shape, dtype=bool)
    for pair in _pairs(a, b):
        apply[:, pair.a, pair.b] |= pair.rows[at[:, 0]] & pair.columns[at[:, 1]]
    cell, i, j = np.nonzero(apply)
    gap = gaps[cell, i, j]
    best: Nearest | None = None
    for k in np.argsort(gap, kind="stable").tolist():
        if best is not None and gap[k] >= best.distance_m:
            break
        row, column = int(at[cell[k], 0]), int(at[cell[k], 1])
        x, y = int(i[k]), int(j[k])
        distance = _distance(a, b, row, column, x, y)
        if best is None or distance < best.distance_m:
            best = Nearest(distance, a.labels[x], b.labels[y], (row, column))
    return best


def overlap(a: Swept, b: Swept) -> Nearest | None:
    """The deepest overlap of two bodies at their first positions; None when they do not touch.

    Distance zero is contact: coal answers so where it cannot tell a touch from an overlap.
    """
    gaps = np.linalg.norm(a.centres[0, :, None] - b.centres[0], axis=-1) - a.radii_m[:, None] - b.radii_m
    if gaps.min() > 0:
        return None
    found = nearest(a, b, np.zeros((1, 2), dtype=np.int64))
    return found if found is not None and found.distance_m <= 0 else None


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
