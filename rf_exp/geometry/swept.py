"""PlanningScene that move along paths: convex pieces with a pose at every path position.

And such a body cut into blocks of positions, with bounds on how far its pieces move within one, from which
`closer_than` finds coordination diagrams.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import coal
import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry.shapes import Piece

PARTS = 4  # into so many a side is cut where a block stays open
FINE_BLOCK = 8  # from this size on, every cell of a block has its own bounds

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Floats = NDArray[np.floating]  # 32 bits: enough for lengths that `SLACK_M` covers, and twice as fast


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
    base: str | None = None  # the label that is bolted to the table

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

    def only(self, *names: str) -> "Swept":
        """The pieces with these labels."""
        of = [k for k, label in enumerate(self.labels) if label in names]
        pieces, labels = tuple(self.pieces[k] for k in of), tuple(self.labels[k] for k in of)
        return replace(self, pieces=pieces, labels=labels, poses=self.poses[:, of])

    def _moved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(L, 3, P, K) where points (L, K, 3) of the pieces go."""
        turned = self.by_row[..., :3].reshape(len(points), -1, 3) @ points.swapaxes(1, 2)
        return turned.reshape(*self.by_row.shape[:3], -1) + self.by_row[..., 3:]

    @cached_property
    def _placed(self) -> "_Placed":
        return _Placed(self.poses)

    @cached_property
    def _cuts(self) -> dict[tuple[int, bool], "Blocks"]:
        return {}

    def blocks(self, size: int, between: bool) -> "Blocks":
        """The positions cut into blocks of a size (a power of two); a single one is a block of one."""
        key = size if len(self) > 1 else 1, between
        found = self._cuts.get(key)
        if found is None:
            found = self._cuts[key] = Blocks(self, *key)
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


class Blocks:
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


def _with_ones(vectors: Floats) -> Floats:
    """(M, 3) to (M, 4, 1)."""
    return np.concatenate([vectors, np.ones_like(vectors[:, :1])], axis=1)[:, :, None]
