"""Convex pieces of links and objects, and bodies of pieces along paths.

A piece has its exact convex shape (coal), a conservative sphere cover for the broad phase and its face planes
for filling voxels. A body has a pose of each of its pieces at every path position. Its blocks of positions
bound how far pieces move within a block; `closer_than` computes coordination diagrams from these bounds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache

import coal
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from rf_exp.robots import Robot
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import transform_by_poses

COVER_RADIUS_M = 0.06  # spheres of a cover are split until they are smaller than this
COVER_SPHERES = 8  # or until there are this many
CORE_SPHERES = 4
CORE_DEPTHS = (0.0, 0.2, 0.35, 0.5, 0.65)  # candidate centres: fractions of the way from middle to vertices
PARTS = 4  # per side, when an open block is split
FINE_BLOCK = 8  # blocks of at most this size have bounds per cell
PRESSED_M = 0.001  # a load may lie on the table, but penetrate it by no more than this

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Floats = NDArray[np.floating]  # 32 bits: precise enough given `SLACK_M`, and twice as fast


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex piece of a body."""

    vertices: NDArray[np.float64]  # (V, 3)
    planes: NDArray[np.float64]  # (F, 4): unit normal n and offset d with n.x + d <= 0 inside
    corners: NDArray[np.float64]  # (8, 3) of the bounding box
    centre: NDArray[np.float64]  # (3,) of the bounding sphere
    radius_m: float
    cover: NDArray[np.float64]  # (COVER_SPHERES, 4): centre and radius; padded with the first
    core: NDArray[np.float64]  # (CORE_SPHERES, 4): centre and radius of inner spheres
    shape: coal.Convex

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> "Piece":
        """The piece of a convex mesh."""
        vertices = np.asarray(mesh.vertices, dtype=float)
        hull = ConvexHull(vertices)
        # A triangulated flat face repeats its plane.
        _, first = np.unique(np.round(hull.equations, 6), axis=0, return_index=True)
        centre, radius_m = enclosing_sphere(vertices)
        return Piece(
            vertices=vertices,
            planes=hull.equations[np.sort(first)],
            corners=trimesh.bounds.corners([vertices.min(axis=0), vertices.max(axis=0)]),
            centre=centre,
            radius_m=radius_m,
            cover=cover(vertices),
            core=core(vertices, hull.equations),
            shape=_coal(vertices),
        )


def enclosing_sphere(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centre and radius of a small sphere that contains all points (K, 3), by Badoiu and Clarkson's steps."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 60):
        farthest = points[np.argmax(np.sum((points - centre) ** 2, axis=1))]
        centre = centre + (farthest - centre) / (step + 1)
    return centre, float(np.sqrt(np.max(np.sum((points - centre) ** 2, axis=1)))) + 1e-9


def cover(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spheres (COVER_SPHERES, 4) whose union contains the convex hull of the vertices.

    The hull is cut by planes into convex cells. A sphere around the corners of a convex cell contains
    the cell, so the whole hull is covered.
    """
    cells = [vertices]
    spheres = [enclosing_sphere(vertices)]
    while len(cells) < COVER_SPHERES:
        largest = int(np.argmax([radius for _, radius in spheres]))
        if spheres[largest][1] < COVER_RADIUS_M:
            break
        halves = _halves(cells.pop(largest))
        spheres.pop(largest)
        cells += halves
        spheres += [enclosing_sphere(half) for half in halves]
    rows = np.array([[*centre, radius] for centre, radius in spheres])
    return np.concatenate([rows, np.repeat(rows[:1], COVER_SPHERES - len(rows), axis=0)])


def core(vertices: NDArray[np.float64], planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spheres (CORE_SPHERES, 4) inside the convex hull: the largest one, then those that protrude most."""
    middle = vertices.mean(axis=0)
    centres = np.concatenate([middle + depth * (vertices - middle) for depth in CORE_DEPTHS])
    radii = -np.max(centres @ planes[:, :3].T + planes[:, 3], axis=1)
    chosen = [int(radii.argmax())]
    while len(chosen) < CORE_SPHERES:
        away = np.linalg.norm(centres[:, None] - centres[chosen], axis=2) - radii[chosen]
        chosen.append(int(np.argmax(away.min(axis=1) + radii)))
    return np.column_stack([centres, np.maximum(radii, 0)])[chosen]


def _halves(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The corners of the two halves of a convex hull, cut across its longest axis."""
    hull = ConvexHull(points)
    axis = int(np.argmax(np.ptp(points, axis=0)))
    cut = (points[:, axis].min() + points[:, axis].max()) / 2
    edges = np.concatenate([hull.simplices[:, [0, 1]], hull.simplices[:, [1, 2]], hull.simplices[:, [2, 0]]])
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    crossing = (a[:, axis] - cut) * (b[:, axis] - cut) < 0
    a, b = a[crossing], b[crossing]
    fraction = (cut - a[:, axis]) / (b[:, axis] - a[:, axis])
    on_cut = a + fraction[:, None] * (b - a)
    corners = points[hull.vertices]
    return [
        np.concatenate([corners[corners[:, axis] <= cut], on_cut]),
        np.concatenate([corners[corners[:, axis] >= cut], on_cut]),
    ]


def _coal(vertices: NDArray[np.float64]) -> coal.Convex:
    mesh = trimesh.convex.convex_hull(vertices)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for corner in np.asarray(mesh.vertices):
        points.append(corner)
    faces.extend([coal.Triangle(*face) for face in mesh.faces.tolist()])
    return coal.Convex(points, faces)


@cache
def arm_pieces(robot: Robot) -> tuple[Piece, ...]:
    """The pieces of an arm, in the order of its links."""
    hulls = robot.hulls
    return tuple(Piece.of(hulls[link]) for link in robot.links)


@lru_cache(maxsize=1024)  # bounded: every third-party scene that is read has assets of its own
def asset_pieces(asset: Asset) -> tuple[Piece, ...]:
    """The pieces of an asset, in its frame; none for a mark on the table, which has no collision shapes."""
    return tuple(Piece.of(hull) for hull in asset.hulls)


@dataclass(frozen=True, eq=False)
class Swept:
    """Convex pieces of one body at P path positions, world frame."""

    pieces: tuple[Piece, ...]
    labels: tuple[str, ...]  # (L,) link or object that each piece belongs to
    poses: NDArray[np.float64]  # (P, L, 4, 4) world_from_piece
    objects: frozenset[str] = frozenset()  # the labels that are objects
    carried: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) it moves with the gripper
    touches: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) the gripper may touch it
    rests: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) carried objects may touch it
    holds: Mapping[str, Mask] = field(default_factory=dict)  # object -> (P,) it is in the gripper
    gripper: frozenset[str] = frozenset()  # the labels of the gripper's links
    base: str | None = None  # the label of the robot's base

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def radii_m(self) -> NDArray[np.float64]:
        """Radii (L,) of the bounding spheres of the pieces."""
        return np.array([piece.radius_m for piece in self.pieces])

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Centres (P, L, 3) of the bounding spheres of the pieces."""
        local = np.array([piece.centre for piece in self.pieces]).reshape(-1, 3)
        return np.einsum("plij,lj->pli", self.poses[..., :3, :3], local) + self.poses[..., :3, 3]

    @cached_property
    def by_row(self) -> NDArray[np.float64]:
        """Poses (L, 3, P, 4) without last rows, so that one product places a piece at all positions."""
        return np.ascontiguousarray(self.poses[..., :3, :].transpose(1, 2, 0, 3))

    @cached_property
    def core(self) -> NDArray[np.float64]:
        """Centres (L, 3, P, K) of the inner spheres of the pieces."""
        return self._along_path(np.array([piece.core[:, :3] for piece in self.pieces]))

    @cached_property
    def step_m(self) -> NDArray[np.float64]:
        """Bound (P - 1, L) on how far any point of a piece moves from one position to the next."""
        step = np.diff(self._along_path(np.array([piece.corners for piece in self.pieces])), axis=2)
        return np.sqrt(np.max(np.sum(step**2, axis=1), axis=-1)).T

    @cached_property
    def travelled_m(self) -> NDArray[np.float64]:
        """Sum (P, L) of `step_m` up to each position."""
        return np.concatenate([np.zeros((1, len(self.pieces))), np.cumsum(self.step_m, axis=0)])

    @cached_property
    def turned_m(self) -> NDArray[np.float64]:
        """As `travelled_m` (P, L), for the motion relative to the centre of the bounding sphere."""
        delta = np.diff(self.poses[..., :3, :3], axis=0)
        step = np.sqrt(np.sum(delta**2, axis=(2, 3)) / 2) * self.radii_m  # |R - 1| is 1/sqrt(2) of Frobenius'
        return np.concatenate([np.zeros((1, len(self.pieces))), np.cumsum(step, axis=0)])

    @cached_property
    def stride_m(self) -> NDArray[np.float64]:
        """The larger (P, L) of the two steps adjacent to each position."""
        step = self.step_m
        edge = np.zeros((1, len(self.pieces)))
        return np.maximum(np.concatenate([edge, step]), np.concatenate([step, edge]))

    def only(self, *names: str) -> "Swept":
        """The pieces with these labels."""
        indices = [k for k, label in enumerate(self.labels) if label in names]
        pieces, labels = tuple(self.pieces[k] for k in indices), tuple(self.labels[k] for k in indices)
        return replace(self, pieces=pieces, labels=labels, poses=self.poses[:, indices])

    def _along_path(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions (L, 3, P, K) of points (L, K, 3) of the pieces along the path."""
        turned = self.by_row[..., :3].reshape(len(points), -1, 3) @ points.swapaxes(1, 2)
        return turned.reshape(*self.by_row.shape[:3], -1) + self.by_row[..., 3:]

    @cached_property
    def _coal_transforms(self) -> "_CoalTransforms":
        return _CoalTransforms(self.poses)

    @cached_property
    def _blocks(self) -> dict[tuple[int, bool], "Blocks"]:
        return {}

    def blocks(self, size: int, between: bool) -> "Blocks":
        """The positions in blocks of a size (a power of two); a single position is a block of size one."""
        key = size if len(self) > 1 else 1, between
        if key not in self._blocks:
            self._blocks[key] = Blocks(self, *key)
        return self._blocks[key]

    def coal_transform(self, position: int, piece: int) -> coal.Transform3s:
        """coal's transform of a piece."""
        return self._coal_transforms[position * len(self.pieces) + piece]

    def shapes(self, positions: Indices, pieces: Indices) -> tuple[list[coal.Convex], list[coal.Transform3s]]:
        """coal's shapes and transforms of pieces (M,)."""
        shapes = [piece.shape for piece in self.pieces]
        keys = (positions * len(shapes) + pieces).tolist()
        return [shapes[piece] for piece in pieces.tolist()], [self._coal_transforms[key] for key in keys]


def merged(bodies: Sequence[Swept]) -> Swept:
    """One body of several with equal numbers of positions: arms without loads, or static objects."""
    return Swept(
        tuple(piece for body in bodies for piece in body.pieces),
        tuple(label for body in bodies for label in body.labels),
        np.concatenate([body.poses for body in bodies], axis=1),
        frozenset().union(*(body.objects for body in bodies)),
        gripper=frozenset().union(*(body.gripper for body in bodies)),
    )


class _CoalTransforms(dict[int, coal.Transform3s]):
    """Lazy coal transforms of poses (P, L, 4, 4), by flat index over P x L."""

    def __init__(self, poses: NDArray[np.float64]) -> None:
        super().__init__()
        self._poses = poses.reshape(-1, 4, 4)

    def __missing__(self, key: int) -> coal.Transform3s:
        pose = self._poses[key]
        placement = self[key] = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        return placement


class Blocks:
    """A body in B blocks of S path positions; the last block is padded with the last position."""

    def __init__(self, body: Swept, size: int, between: bool) -> None:
        self.body, self.size = body, size
        self.parts = min(PARTS, size)
        self.fine = size <= FINE_BLOCK
        self.bounds = size if self.fine else self.parts  # per side of a block
        begin = np.arange(0, len(body), size)
        self.rows = np.minimum(begin[:, None] + np.arange(size), len(body) - 1)  # (B, S)
        self.middle = (self.rows[:, 0] + self.rows[:, -1]) // 2
        self.added_motion_m = self._spread(body.stride_m / 2 if between else np.zeros_like(body.stride_m))
        # (L, B, bounds) largest travel of a piece from the middle, less the motion added by `between`
        self.surplus_m = self._largest(np.abs(self._since_middle(body.travelled_m)) - self.added_motion_m)

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Centres (B, L, 3) of bounding spheres, in the middles of the blocks."""
        return self.body.centres[self.middle]

    @cached_property
    def reach_m(self) -> NDArray[np.float64]:
        """Radii (B, L) of spheres around the volume that a piece sweeps in a block, with the added motion."""
        away = np.linalg.norm(self.body.centres[self.rows] - self.centres[:, None], axis=-1).max(axis=1)
        return away + self.body.radii_m + self.added_motion_m.max(axis=2).T

    @cached_property
    def cover(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres (B, L, K, 3) and radii (L, K) of the sphere covers, in the middles of the blocks."""
        local = np.array([piece.cover for piece in self.body.pieces])
        return transform_by_poses(self.body.poses[self.middle], local[..., :3]), local[..., 3]

    @cached_property
    def _motion_bounds(self) -> Floats:
        """Shift of the centre from the middle, and bound on further motion of points: (L, B, S, 3 + 1)."""
        motion = np.concatenate([self.body.centres, self.body.turned_m[..., None]], axis=2)
        bounds = self._since_middle(motion)
        bounds[..., 3] = np.abs(bounds[..., 3]) + self.added_motion_m
        return bounds

    @cached_property
    def core(self) -> Floats:
        """Centres (L, K, B, 3, S) of the inner spheres of the pieces."""
        spread = self.body.core[:, :, self.rows].transpose(0, 4, 2, 1, 3)
        return np.ascontiguousarray(spread, dtype=np.float32)

    @cached_property
    def core_middle(self) -> Floats:
        """`core` in the middles of the blocks (L, B, K, 3)."""
        middle = self.body.core[:, :, self.middle].transpose(0, 2, 3, 1)
        return np.ascontiguousarray(middle, dtype=np.float32)

    @cached_property
    def core_m(self) -> Floats:
        """Radii (L, K) of the inner spheres of the pieces."""
        return np.array([piece.core[:, 3] for piece in self.body.pieces], dtype=np.float32)

    @cached_property
    def _by_row(self) -> Floats:
        """Poses (L, B, 3, S, 4) without last rows."""
        return np.ascontiguousarray(self.body.by_row[:, :, self.rows].swapaxes(1, 2), dtype=np.float32)

    def _spread(self, values: NDArray[np.float64]) -> Floats:
        """Values (P, L, ...) per cell of the blocks (L, B, S, ...)."""
        return np.take(np.moveaxis(values, 1, 0).astype(np.float32), self.rows, axis=1)

    def _since_middle(self, values: NDArray[np.float64]) -> Floats:
        middle = np.moveaxis(values[self.middle], 1, 0)[:, :, None]
        return self._spread(values) - middle.astype(np.float32)

    def _largest(self, values: Floats) -> Floats:
        """The largest values per bound: (..., S) to (..., bounds)."""
        return values if self.fine else values.reshape(*values.shape[:-1], self.bounds, -1).max(axis=-1)

    def approach_bound_m(self, piece: Indices, block: Indices, normal: Floats) -> Floats:
        """Bounds (M, bounds) on the motion of pieces along normals (M, 3), with the added motion."""
        return self._largest((self._motion_bounds[piece, block] @ _with_ones(normal))[..., 0])

    def carried_points(self, piece: Indices, block: Indices, point: Floats) -> Floats:
        """Positions (M, 3, S), over the blocks, of world points (M, 3) fixed to pieces in the middles."""
        poses = self._by_row[piece, block]  # (M, 3, S, 4)
        middle = self.body.poses[self.middle[block], piece]
        local = (point - middle[:, :3, 3])[:, None] @ middle[:, :3, :3]
        moved = poses.reshape(-1, 3 * self.size, 4) @ _with_ones(local[:, 0].astype(np.float32))
        return moved.reshape(-1, 3, self.size)


def _with_ones(vectors: Floats) -> Floats:
    """Homogeneous vectors: (M, 3) to (M, 4, 1)."""
    return np.concatenate([vectors, np.ones_like(vectors[:, :1])], axis=1)[:, :, None]


def lowest_m(body: Swept) -> NDArray[np.float64]:
    """Lowest points (P,) of all links but the base, and of loads: these must stay above the table.

    Loads may lie on the table: `PRESSED_M` is added to their height, and they count only while carried.
    """
    lowest = np.full(len(body), np.inf)
    for column, (piece, label) in enumerate(zip(body.pieces, body.labels, strict=True)):
        if label == body.base or (label in body.objects and not body.carried[label].any()):
            continue
        poses = body.poses[:, column]
        sphere = poses[:, 2, :3] @ piece.centre + poses[:, 2, 3] - piece.radius_m
        rows = np.flatnonzero(sphere < lowest)
        height = (poses[rows, 2, :3] @ piece.vertices.T).min(axis=1) + poses[rows, 2, 3]
        if label in body.objects:
            height = np.where(body.carried[label][rows], height + PRESSED_M, np.inf)
        lowest[rows] = np.minimum(lowest[rows], height)
    return lowest
