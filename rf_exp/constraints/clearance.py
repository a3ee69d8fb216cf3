"""Exact clearance between bodies that move along paths.

A body is a set of convex pieces with a pose at every path position. The answer for two bodies is
their coordination diagram: which pairs of positions come closer than a margin. It is found coarse
to fine: blocks of the diagram are settled as a whole by spheres round the pieces, or by one exact
distance (coal) and the bound on how far the pieces move within the block; the rest is split.
Nothing is sampled away: the diagram equals the exact test of every cell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import coal
import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.shapes import Piece

BLOCK = 32  # positions on the side of the first blocks
EXACT_BLOCK = 8  # from this size on, an exact distance may settle a block
SLACK_M = 1e-4  # for coal's tolerance; doubt counts as too close

Mask = NDArray[np.bool_]


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
    def cover_radii_m(self) -> NDArray[np.float64]:
        """(L, K) of the spheres that cover each piece."""
        return np.array([piece.cover[:, 3] for piece in self.pieces])

    @cached_property
    def cover_centres(self) -> NDArray[np.float64]:
        """(P, L, K, 3) of the spheres that cover each piece."""
        local = np.array([piece.cover[:, :3] for piece in self.pieces])
        return np.einsum("plij,lkj->plki", self.poses[..., :3, :3], local) + self.poses[..., None, :3, 3]

    @cached_property
    def step_m(self) -> NDArray[np.float64]:
        """(P - 1, L) bound on how far any point of a piece moves from one position to the next."""
        delta = np.diff(self.poses, axis=0)
        local = np.array([piece.corners for piece in self.pieces])
        moved = np.einsum("plij,lkj->plki", delta[..., :3, :3], local) + delta[..., None, :3, 3]
        return np.sqrt(np.max(np.sum(moved**2, axis=-1), axis=-1))

    @cached_property
    def travelled_m(self) -> NDArray[np.float64]:
        """(P, L) the sum of `step_m` up to each position."""
        return np.concatenate([np.zeros((1, len(self.pieces))), np.cumsum(self.step_m, axis=0)])

    @cached_property
    def stride_m(self) -> NDArray[np.float64]:
        """(P, L) the longer one of the two steps beside each position."""
        step = self.step_m
        edge = np.zeros((1, len(self.pieces)))
        return np.maximum(np.concatenate([edge, step]), np.concatenate([step, edge]))

    @cached_property
    def _placed(self) -> dict[tuple[int, int], coal.Transform3s]:
        return {}

    def placed(self, position: int, piece: int) -> coal.Transform3s:
        """coal's transform of a piece."""
        key = (position, piece)
        found = self._placed.get(key)
        if found is None:
            pose = self.poses[position, piece]
            found = self._placed[key] = coal.Transform3s(pose[:3, :3], pose[:3, 3])
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
            if rows.any() and columns.any():
                yield _Pair(i, j, rows, columns)


def closer_than(a: Swept, b: Swept, margin_m: float, *, between: bool = True) -> Mask:
    """The coordination diagram (P, Q): True where the bodies come closer than the margin.

    With `between`, a cell also keeps half of what both bodies move to the neighbouring positions
    free. Two free neighbours then prove that the motion between them keeps the margin as well:
    along it the distance is at least (d0 + d1 - moved) / 2.
    """
    forbidden = np.zeros((len(a), len(b)), dtype=bool)
    pairs = tuple(_pairs(a, b))
    if not pairs:
        return forbidden
    first = np.array([pair.a for pair in pairs])
    second = np.array([pair.b for pair in pairs])
    need_a, need_b = (
        (a.stride_m / 2, b.stride_m / 2) if between else (0 * a.centres[..., 0], 0 * b.centres[..., 0])
    )

    active_rows = _counts([pair.rows for pair in pairs])
    active_columns = _counts([pair.columns for pair in pairs])

    # blocks: pair, first and last row, first and last column
    starts_a, starts_b = np.arange(0, len(a), BLOCK), np.arange(0, len(b), BLOCK)
    pair, row, column = (
        grid.ravel() for grid in np.meshgrid(np.arange(len(pairs)), starts_a, starts_b, indexing="ij")
    )
    blocks = np.stack(
        [pair, row, np.minimum(row + BLOCK, len(a)) - 1, column, np.minimum(column + BLOCK, len(b)) - 1],
        axis=1,
    )
    size = BLOCK
    while len(blocks):
        pair, r0, r1, c0, c1 = blocks.T
        rows_on = active_rows[pair, r1 + 1] - active_rows[pair, r0]
        columns_on = active_columns[pair, c1 + 1] - active_columns[pair, c0]
        r, c = (r0 + r1) // 2, (c0 + c1) // 2
        near = (rows_on > 0) & (columns_on > 0)
        if size < EXACT_BLOCK:  # other pairs may have settled the block
            settled = np.cumsum(np.cumsum(np.pad(forbidden, ((1, 0), (1, 0))), axis=0), axis=1)
            inside = settled[r1 + 1, c1 + 1] - settled[r0, c1 + 1] - settled[r1 + 1, c0] + settled[r0, c0]
            near &= inside < (r1 - r0 + 1) * (c1 - c0 + 1)
        i, j = first[pair], second[pair]
        moved = _within(a.travelled_m, r0, r, r1, i) + _within(b.travelled_m, c0, c, c1, j)
        needs_a, needs_b = _block(need_a, r0, r1, i, size), _block(need_b, c0, c1, j, size)
        most = margin_m + needs_a.max(axis=1) + needs_b.max(axis=1)
        apart = np.linalg.norm(a.centres[r, i] - b.centres[c, j], axis=1) - a.radii_m[i] - b.radii_m[j]
        near = np.flatnonzero(near & (apart - moved < most))
        near = near[_cover_gap(a, b, r[near], c[near], i[near], j[near]) - moved[near] < most[near]]
        if size <= EXACT_BLOCK:
            whole = (rows_on == r1 - r0 + 1) & (columns_on == c1 - c0 + 1)
            least = margin_m + needs_a.min(axis=1) + needs_b.min(axis=1)
            free_at, closer_at = (most + moved + SLACK_M).tolist(), (least - moved - SLACK_M).tolist()
            r, c, i, j, undecided = r.tolist(), c.tolist(), i.tolist(), j.tolist(), []
            for k in near[np.argsort(apart[near], kind="stable")].tolist():  # the deepest settle most
                block = slice(r0[k], r1[k] + 1), slice(c0[k], c1[k] + 1)
                if forbidden[r[k], c[k]] and forbidden[block].all():
                    continue
                distance = _distance(a, b, r[k], c[k], i[k], j[k])
                if distance >= free_at[k]:
                    continue
                if size > 1 and distance >= closer_at[k]:
                    undecided.append(k)
                    continue
                if whole[k]:
                    forbidden[block] = True
                else:
                    forbidden[block] |= np.outer(
                        pairs[pair[k]].rows[block[0]], pairs[pair[k]].columns[block[1]]
                    )
            near = undecided
        blocks = _split(blocks[near])
        size //= 2
    return forbidden


def _counts(masks: Sequence[Mask]) -> NDArray[np.int64]:
    """(M, P + 1) how many positions before each one are set."""
    return np.pad(np.cumsum(masks, axis=1, dtype=np.int64), ((0, 0), (1, 0)))


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
    """The deepest overlap of two bodies at their first positions; None when they do not touch."""
    gaps = np.linalg.norm(a.centres[0, :, None] - b.centres[0], axis=-1) - a.radii_m[:, None] - b.radii_m
    if gaps.min() > 0:
        return None
    found = nearest(a, b, np.zeros((1, 2), dtype=np.int64))
    return found if found is not None and found.distance_m < 0 else None


def folded(body: Swept, pairs: Sequence[tuple[int, int]]) -> Mask:
    """(P,) True where two pieces of one body that may not touch (index pairs) overlap."""
    first, second = np.array(pairs).T
    gaps = np.linalg.norm(body.centres[:, first] - body.centres[:, second], axis=-1)  # (P, pairs)
    near = gaps < body.radii_m[first] + body.radii_m[second]
    hit = np.zeros(len(body), dtype=bool)
    for row, k in np.argwhere(near).tolist():
        hit[row] |= not hit[row] and _distance(body, body, row, row, *pairs[k]) < 0
    return hit


_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()


def _distance(a: Swept, b: Swept, row: int, column: int, i: int, j: int) -> float:
    _RESULT.clear()
    return coal.distance(
        a.pieces[i].shape, a.placed(row, i), b.pieces[j].shape, b.placed(column, j), _REQUEST, _RESULT
    )


def _cover_gap(a: Swept, b: Swept, rows, columns, i, j) -> NDArray[np.float64]:
    """(M,) lower bound on the distance of the pieces, from the spheres that cover them."""
    if not len(rows):
        return np.zeros(0)
    x, y = a.cover_centres[rows, i], b.cover_centres[columns, j]  # (M, K, 3)
    squared = np.sum(x**2, axis=2)[:, :, None] + np.sum(y**2, axis=2)[:, None] - 2 * x @ y.swapaxes(1, 2)
    gaps = np.sqrt(np.maximum(squared, 0.0)) - a.cover_radii_m[i][:, :, None] - b.cover_radii_m[j][:, None]
    return gaps.min(axis=(1, 2))


def _within(travelled, low, middle, high, piece) -> NDArray[np.float64]:
    """How far a piece may be from where it is in the middle of a block."""
    return np.maximum(
        travelled[high, piece] - travelled[middle, piece], travelled[middle, piece] - travelled[low, piece]
    )


def _block(values, low, high, piece, size: int) -> NDArray[np.float64]:
    """(M, size) values of the rows low..high of each block."""
    return values[np.minimum(low[:, None] + np.arange(size), high[:, None]), piece[:, None]]


def _split(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each block in (up to) four."""
    pair, r0, r1, c0, c1 = blocks.T
    r, c = (r0 + r1) // 2, (c0 + c1) // 2
    quarters = np.concatenate(
        [
            np.stack(quarter, axis=1)
            for quarter in (
                (pair, r0, r, c0, c),
                (pair, r0, r, c + 1, c1),
                (pair, r + 1, r1, c0, c),
                (pair, r + 1, r1, c + 1, c1),
            )
        ]
    )
    return quarters[(quarters[:, 1] <= quarters[:, 2]) & (quarters[:, 3] <= quarters[:, 4])]
