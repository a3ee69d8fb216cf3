"""3-D occupancy in 5 cm voxels (paper, section 3.2), filled from volumes, not from joint positions.

A voxel is occupied unless a face of the piece or its bounding box separates the two. This includes
every voxel that the piece enters, and a few that it misses narrowly at an edge. Two bodies that touch
share a voxel. World frame; voxel k spans [k, k + 1) * `voxel_m` on each axis.
"""

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry.swept import Mask, Piece, Swept
from rf_exp.transforms import Matrix, apply

VOXEL_M = 0.05
SPAN = 1 << 20  # distinct voxel indices along an axis
HALF_SPAN = SPAN // 2

Voxels = NDArray[np.int64]  # (K, 3)


def fill(piece: Piece, pose: Matrix, voxel_m: float = VOXEL_M) -> Voxels:
    """Voxels (K, 3) that a convex piece at a pose (4, 4) enters."""
    vertices = apply(pose, piece.vertices)
    low = np.floor(vertices.min(axis=0) / voxel_m).astype(np.int64)
    high = np.floor(vertices.max(axis=0) / voxel_m).astype(np.int64)
    grid = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
    normals, offsets = _faces(piece, pose)
    reach = np.abs(normals).sum(axis=1) * voxel_m / 2 + 1e-9
    outside = (grid + 0.5) * voxel_m @ normals.T + offsets > reach
    return grid[~outside.any(axis=1)]


def voxels(body: Swept, position: int = 0, voxel_m: float = VOXEL_M) -> Voxels:
    """Voxels (K, 3) of a body at one path position, unique, in lexical order."""
    placed = zip(body.pieces, body.poses[position], strict=True)
    filled = [_keys(fill(piece, pose, voxel_m)) for piece, pose in placed]
    return _from_keys(np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *filled])))


def centres_m(occupied: Voxels) -> NDArray[np.float64]:
    """World positions (K, 3) of the centres of voxels, for the default `VOXEL_M`."""
    return (occupied.astype(np.float64) + 0.5) * VOXEL_M


def shared(a: Voxels, b: Voxels) -> Voxels:
    """Voxels (K, 3) that are in both, unique, in lexical order."""
    return _from_keys(np.intersect1d(_keys(a), _keys(b)))


def contained_in(occupied: Voxels, others: Voxels) -> Mask:
    """Mask (K,), True for voxels that are also in `others` (L, 3)."""
    return np.isin(_keys(occupied), _keys(others))


def within_margin(occupied: Voxels, body: Swept, margin_m: float) -> Mask:
    """Mask (K,), True for voxels closer than a margin to a body at its first path position.

    As in `fill`, only faces and bounding boxes are tested, so at edges the margin is slightly larger.
    """
    near = np.zeros(len(occupied), dtype=bool)
    low, high = occupied * VOXEL_M - margin_m, (occupied + 1) * VOXEL_M + margin_m
    for piece, pose in zip(body.pieces, body.poses[0], strict=True):
        vertices = apply(pose, piece.vertices)
        close = ((vertices.max(axis=0) >= low) & (vertices.min(axis=0) <= high)).all(axis=1)
        normals, offsets = _faces(piece, pose)
        reach = np.abs(normals).sum(axis=1) * VOXEL_M / 2 + margin_m
        close[close] = (centres_m(occupied[close]) @ normals.T + offsets <= reach).all(axis=1)
        near |= close
    return near


def _faces(piece: Piece, pose: Matrix) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals (F, 3) and offsets (F,) of the faces of a piece at a pose, as in `Piece.planes`."""
    normals = piece.planes[:, :3] @ pose[:3, :3].T
    return normals, piece.planes[:, 3] - normals @ pose[:3, 3]


def _keys(occupied: Voxels) -> NDArray[np.int64]:
    """One integer per voxel (K,), in lexical order: rows are slow to sort and compare."""
    x, y, z = (occupied + HALF_SPAN).T
    return (x * SPAN + y) * SPAN + z


def _from_keys(keys: NDArray[np.int64]) -> Voxels:
    xy, z = np.divmod(keys, SPAN)
    return np.column_stack([*np.divmod(xy, SPAN), z]) - HALF_SPAN
