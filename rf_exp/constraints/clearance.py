"""Exact clearance between bodies that move along paths.

A body is a set of convex pieces with a pose at every path position. The answer for two bodies is
their coordination diagram: which pairs of positions come closer than a margin. It is found coarse
to fine. One exact distance (coal) in the middle of a block of the diagram says far more than its one
cell. Along the direction of that distance the two pieces come no nearer than they move along it, and
the two nearest points, carried along with the pieces, never are nearer than the pieces. What neither
bound settles is split. Where pieces overlap deeply, spheres inside them say so without any distance.
Nothing is sampled away: every cell is settled by a bound or exactly.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rf_exp.constraints.shapes import CORE_SPHERES, Piece

BLOCK = 32  # positions on the side of the first blocks
PARTS = 4  # into so many a side is cut where a block stays open
FINE_BLOCK = 8  # from this size on, every cell of a block has its own bounds
SLACK_M = 1e-4  # for coal's tolerance; doubt counts as too close
ASKEW_M = 2.5e-4  # pieces are nearer along coal's direction than its distance: of 120,000 by 0.17 mm at most
DOUBT = 0.2  # of the margin: a cell whose bounds are this near to what it has to keep is not looked at again

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Floats = NDArray[np.floating]  # 32 bits: enough for lengths that `SLACK_M` covers, and twice as fast
Parts = tuple[Indices, Floats]  # (M, 3) what is to do, (M,) m the deeper the sooner

_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()
_NORMAL = _RESULT.normal  # a view: coal writes every normal to this place


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
    def by_row(self) -> NDArray[np.float64]:
        """(L, 3, P, 4) the poses without their last rows, so that one product places a piece everywhere."""
        return np.ascontiguousarray(self.poses[..., :3, :].transpose(1, 2, 0, 3))

    @cached_property
    def core(self) -> NDArray[np.float64]:
        """(L, 3, P, K) centres of the spheres inside the pieces."""
        return self._moved(np.array([piece.core[:, :3] for piece in self.pieces]))

    @cached_property
    def step_m(self) -> NDArray[np.float64]:
        """(P - 1, L) bound on how far any point of a piece moves from one position to the next."""
        step = np.diff(self._moved(np.array([piece.corners for piece in self.pieces])), axis=2)
        return np.sqrt(np.max(np.sum(step**2, axis=1), axis=-1)).T

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

    def _moved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(L, 3, P, K) where points (L, K, 3) of the pieces go."""
        turned = self.by_row[..., :3].reshape(len(points), -1, 3) @ points.swapaxes(1, 2)
        return turned.reshape(*self.by_row.shape[:3], -1) + self.by_row[..., 3:]

    @cached_property
    def _placed(self) -> "_Placed":
        return _Placed(self.poses)

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
        return self._placed[position * len(self.pieces) + piece]

    def shapes(self, positions: Indices, pieces: Indices) -> tuple[list[coal.Convex], list[coal.Transform3s]]:
        """coal's shapes and transforms of pieces (M,)."""
        shapes = [piece.shape for piece in self.pieces]
        keys = (positions * len(shapes) + pieces).tolist()
        return [shapes[piece] for piece in pieces.tolist()], [self._placed[key] for key in keys]


class _Placed(dict[int, coal.Transform3s]):
    """coal's transforms of poses (P, L, 4, 4), counted through, each of them made when it is asked for."""

    def __init__(self, poses: NDArray[np.float64]) -> None:
        super().__init__()
        self._poses = poses.reshape(-1, 4, 4)

    def __missing__(self, key: int) -> coal.Transform3s:
        pose = self._poses[key]
        found = self[key] = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        return found


class _Blocks:
    """A body cut into B blocks of S path positions; the last one is filled up with the last position."""

    def __init__(self, body: Swept, size: int, between: bool) -> None:
        self.body, self.size = body, size
        self.parts = min(PARTS, size)
        self.fine = size <= FINE_BLOCK
        self.bounds = size if self.fine else self.parts  # so many a side
        begin = np.arange(0, len(body), size)
        self.rows = np.minimum(begin[:, None] + np.arange(size), len(body) - 1)  # (B, S)
        self.middle = (self.rows[:, 0] + self.rows[:, -1]) // 2
        self.need_m = self._spread(body.stride_m / 2 if between else np.zeros_like(body.stride_m))
        # (L, B, bounds) the most that a piece travels beyond what it has to keep free
        self.surplus_m = self._most(np.abs(self._since_middle(body.travelled_m)) - self.need_m)

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
    def _sway(self) -> Floats:
        """(L, B, S, 4) how the centre has shifted since the middle, and how far points come besides."""
        way = np.concatenate([self.body.centres, self.body.turned_m[..., None]], axis=2)
        sway = self._since_middle(way)
        sway[..., 3] = np.abs(sway[..., 3]) + self.need_m
        return sway

    @cached_property
    def core(self) -> Floats:
        """(L, K, B, 3, S) centres of the spheres inside the pieces."""
        spread = self.body.core[:, :, self.rows].transpose(0, 4, 2, 1, 3)
        return np.ascontiguousarray(spread, dtype=np.float32)

    @cached_property
    def core_middle(self) -> Floats:
        """(L, B, K, 3) `core` in the middles of the blocks."""
        middle = self.body.core[:, :, self.middle].transpose(0, 2, 3, 1)
        return np.ascontiguousarray(middle, dtype=np.float32)

    @cached_property
    def core_m(self) -> Floats:
        """(L, K) radii of the spheres inside the pieces."""
        return np.array([piece.core[:, 3] for piece in self.body.pieces], dtype=np.float32)

    @cached_property
    def _by_row(self) -> Floats:
        """(L, B, 3, S, 4) poses."""
        return np.ascontiguousarray(self.body.by_row[:, :, self.rows].swapaxes(1, 2), dtype=np.float32)

    def _spread(self, values: NDArray[np.float64]) -> Floats:
        """(P, L, ...) to (L, B, S, ...), as all that belongs to the cells of blocks."""
        return np.take(np.moveaxis(values, 1, 0).astype(np.float32), self.rows, axis=1)

    def _since_middle(self, values: NDArray[np.float64]) -> Floats:
        middle = np.moveaxis(values[self.middle], 1, 0)[:, :, None]
        return self._spread(values) - middle.astype(np.float32)

    def _most(self, values: Floats) -> Floats:
        """(..., S) to (..., bounds)."""
        return values if self.fine else values.reshape(*values.shape[:-1], self.bounds, -1).max(axis=-1)

    def advance_m(self, piece: Indices, block: Indices, normal: Floats) -> Floats:
        """(M, bounds) how far pieces may come along normals (M, 3), with what they keep free."""
        return self._most((self._sway[piece, block] @ _with_ones(normal))[..., 0])

    def carry(self, piece: Indices, block: Indices, point: Floats) -> Floats:
        """(M, 3, S) where world points (M, 3) of pieces in the middles go."""
        poses = self._by_row[piece, block]  # (M, 3, S, 4)
        middle = self.body.poses[self.middle[block], piece]
        local = (point - middle[:, :3, 3])[:, None] @ middle[:, :3, :3]
        moved = poses.reshape(-1, 3 * self.size, 4) @ _with_ones(local[:, 0].astype(np.float32))
        return moved.reshape(-1, 3, self.size)


class _Pair(NamedTuple):
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
        if size == FINE_BLOCK:
            diagram.pierce(todo, x, y)
        left = []
        for some in _first_of_each_block(todo, len(y)):
            some = diagram.open_blocks(some, x, y)
            if len(some):
                left.append(diagram.settle(some, x, y))
        if not left:
            break
        todo, gap = (np.concatenate(each) for each in zip(*left, strict=True))
        todo = todo[np.argsort(gap, kind="stable")]
        size //= min(PARTS, size)
    return diagram.forbidden[: len(a), : len(b)]


class _Diagram:
    """A diagram in the making. What is to do: (M, 3) pair of pieces, block of rows, block of columns."""

    def __init__(self, a: Swept, b: Swept, pairs: Sequence[_Pair], margin_m: float) -> None:
        self.margin_m = margin_m
        self.a, self.b = np.array([pair.a for pair in pairs]), np.array([pair.b for pair in pairs])
        rows, columns = (-(-len(body) // BLOCK) * BLOCK for body in (a, b))
        self.rows = np.zeros((len(pairs), rows), dtype=bool)
        self.columns = np.zeros((len(pairs), columns), dtype=bool)
        self.rows[:, : len(a)] = [pair.rows for pair in pairs]
        self.columns[:, : len(b)] = [pair.columns for pair in pairs]
        self.forbidden = np.ones((rows, columns), dtype=bool)  # beyond the ends nothing is left to find
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
        length_m = np.maximum(np.linalg.norm(line, axis=1, keepdims=True), SLACK_M)
        normal = (line / length_m).astype(np.float32)
        (centres_a, radii_a), (centres_b, radii_b) = x.cover, y.cover
        far_a = ((centres_a[r, i] @ normal[:, :, None])[..., 0] + radii_a[i]).max(axis=1)
        near_b = ((centres_b[c, j] @ normal[:, :, None])[..., 0] - radii_b[j]).min(axis=1)
        advance = x.advance_m(i, r, normal).max(axis=1) + y.advance_m(j, c, -normal).max(axis=1)
        near = np.flatnonzero(near_b - far_a - advance < self.margin_m)
        return todo[near[np.argsort(gaps[pair[near], r[near], c[near]], kind="stable")]]

    def open_blocks(self, todo: Indices, x: _Blocks, y: _Blocks) -> Indices:
        """What is not forbidden altogether."""
        return todo[~self._cells(todo, x, y).all(axis=(1, 2))]

    def pierce(self, todo: Indices, x: _Blocks, y: _Blocks) -> None:
        """Forbids cells in which spheres inside the pieces come too close: most of them need no distance."""
        todo = self.open_blocks(todo, x, y)
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        radii = x.core_m[i][:, :, None] + y.core_m[j][:, None]  # (M, K, K)
        line = x.core_middle[i, r][:, :, None] - y.core_middle[j, c][:, None]
        depth = radii - np.sqrt(np.einsum("mkli,mkli->mkl", line, line))
        deepest = depth.reshape(len(todo), CORE_SPHERES**2).argmax(axis=1)
        k, m = np.divmod(deepest, CORE_SPHERES)
        most = _apart_m(x.core[i, k, r], y.core[j, m, c]) - radii[np.arange(len(todo)), k, m][:, None, None]
        most -= x.need_m[i, r][:, :, None] + y.need_m[j, c][:, None]
        self._forbid(todo, (most < self.margin_m) & self._concerned(todo, x.size, y.size))

    def settle(self, todo: Indices, x: _Blocks, y: _Blocks) -> Parts:
        """Settles parts of blocks, or cells of fine ones, by bounds; returns the parts that stay open."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        distance, normal, point_a = _look(x, y, todo, i, j)
        # bounds on what the pieces have beyond what they keep free
        advance = x.advance_m(i, r, normal)[:, :, None] + y.advance_m(j, c, -normal)[:, None]
        least = distance[:, None, None] - advance
        most = distance[:, None, None] + x.surplus_m[i, r][:, :, None] + y.surplus_m[j, c][:, None]
        open_ = ~(least >= self.margin_m + ASKEW_M)
        if not (x.fine and y.fine):
            closer = most < self.margin_m - SLACK_M
            parts, _ = _parts(todo, closer, most, x, y)
            self._forbid(parts, self._concerned(parts, x.size // x.parts, y.size // y.parts))
            return _parts(todo, open_ & ~closer, least + most, x, y)
        most = np.fmin(most, self._carried_m(todo, x, y, distance, normal, point_a))
        if x.size == y.size == 1:  # exact, also where coal has no direction to give
            open_ = ~(most >= self.margin_m + SLACK_M)
        open_ &= self._concerned(todo, x.size, y.size)
        self._forbid(todo, open_ & (most < self.margin_m + max(SLACK_M, DOUBT * self.margin_m)))
        open_ &= ~self._cells(todo, x, y)
        return _parts(todo, open_, least + most, x, y)

    def _carried_m(
        self, todo: Indices, x: _Blocks, y: _Blocks, distance: Floats, normal: Floats, point_a: Floats
    ) -> Floats:
        """(M, S, S) distance of the two nearest points carried with their pieces, less what is kept free."""
        pair, r, c = todo.T
        i, j = self.a[pair], self.b[pair]
        inside = np.minimum(distance, 0)[:, None] / 2  # where pieces overlap: a point of both
        points_a = x.carry(i, r, point_a + inside * normal)
        points_b = y.carry(j, c, point_a + (distance[:, None] - inside) * normal)
        return _apart_m(points_a, points_b) - x.need_m[i, r][:, :, None] - y.need_m[j, c][:, None]

    def _cells(self, todo: Indices, x: _Blocks, y: _Blocks) -> Mask:
        """(M, S, S) which cells of the blocks are forbidden by now."""
        blocks = self.forbidden.reshape(-1, x.size, self.forbidden.shape[1] // y.size, y.size)
        return blocks[todo[:, 1], :, todo[:, 2]]

    def _concerned(self, todo: Indices, height: int, width: int) -> Mask:
        """(M, height, width) the cells of blocks in which their pair of pieces has to keep apart."""
        pair, r, c = todo.T
        rows = self.rows.reshape(len(self.rows), -1, height)[pair, r]
        columns = self.columns.reshape(len(self.columns), -1, width)[pair, c]
        return rows[:, :, None] & columns[:, None]

    def _forbid(self, todo: Indices, closer: Mask) -> None:
        """Forbids cells (M, height, width) of blocks."""
        k, row, column = np.nonzero(closer)
        _, height, width = closer.shape
        self.forbidden[todo[k, 1] * height + row, todo[k, 2] * width + column] = True


def _first_of_each_block(todo: Indices, columns: int) -> tuple[Indices, Indices]:
    """The first pair of every block, which may well settle it for the others too, and the others."""
    first = np.zeros(len(todo), dtype=bool)
    first[np.unique(todo[:, 1] * columns + todo[:, 2], return_index=True)[1]] = True
    return todo[first], todo[~first]


def _parts(todo: Indices, open_: Mask, gap: Floats, x: _Blocks, y: _Blocks) -> Parts:
    """The parts of blocks in which `open_` (M, bounds, bounds) is set, and their gaps."""
    height, width = x.bounds // x.parts, y.bounds // y.parts
    parts = np.zeros((len(todo), x.parts, y.parts), dtype=bool)
    k, row, column = np.nonzero(open_)
    parts[k, row // height, column // width] = True
    k, row, column = np.nonzero(parts)
    gaps = gap[:, (height - 1) // 2 :: height, (width - 1) // 2 :: width]
    pair, r, c = todo[k].T
    return np.stack([pair, r * x.parts + row, c * y.parts + column], axis=1), gaps[k, row, column]


def _apart_m(a: Floats, b: Floats) -> Floats:
    """(M, S, S) distances of points (M, 3, S)."""
    origin = a[:, :, :1]
    a, b = a - origin, b - origin
    squared = -2 * a.swapaxes(1, 2) @ b
    squared += np.einsum("mis,mis->ms", a, a)[:, :, None] + np.einsum("mis,mis->ms", b, b)[:, None]
    return np.sqrt(np.maximum(squared, 0))


def _with_ones(vectors: Floats) -> Floats:
    """(M, 3) to (M, 4, 1)."""
    return np.concatenate([vectors, np.ones_like(vectors[:, :1])], axis=1)[:, :, None]


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()


def _look(x: _Blocks, y: _Blocks, todo: Indices, i: Indices, j: Indices) -> tuple[Floats, Floats, Floats]:
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
    if not gaps.size or gaps.min() > 0:  # nothing can touch a mark on the table, which has no pieces
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
