"""3-D occupancy in 5 cm voxels (paper, section 3.2), filled from volume, never from joint points.

A voxel counts as occupied unless a face of the piece or its bounding box separates the two. Every
voxel that the piece really enters is therefore in; a few that it just misses at an edge are, too.
Two bodies that touch share a voxel. World frame; voxel k spans [k, k + 1) * VOXEL_M on each axis.
"""

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.clearance import Swept
from rf_exp.constraints.shapes import Piece
from rf_exp.transforms import Matrix, apply

VOXEL_M = 0.05

Voxels = NDArray[np.int64]  # (K, 3)


def fill(piece: Piece, pose: Matrix) -> Voxels:
    """Voxels (K, 3) that a convex piece at a pose (4, 4) enters."""
    vertices = apply(pose, piece.vertices)
    low = np.floor(vertices.min(axis=0) / VOXEL_M).astype(np.int64)
    high = np.floor(vertices.max(axis=0) / VOXEL_M).astype(np.int64)
    grid = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
    normals = piece.planes[:, :3] @ pose[:3, :3].T
    offsets = piece.planes[:, 3] - normals @ pose[:3, 3]
    reach = np.abs(normals).sum(axis=1) * VOXEL_M / 2 + 1e-9
    outside = (grid + 0.5) * VOXEL_M @ normals.T + offsets > reach
    return grid[~outside.any(axis=1)]


def voxels(body: Swept, position: int = 0) -> Voxels:
    """Voxels (K, 3) of a body at one path position, without repeats, in lexical order."""
    filled = [fill(piece, pose) for piece, pose in zip(body.pieces, body.poses[position], strict=True)]
    return np.unique(np.concatenate([np.zeros((0, 3), dtype=np.int64), *filled]), axis=0)


def centres_m(occupied: Voxels) -> NDArray[np.float64]:
    """(K, 3) world positions of the middles of voxels."""
    return (occupied.astype(np.float64) + 0.5) * VOXEL_M


def shared(a: Voxels, b: Voxels) -> Voxels:
    """(K, 3) voxels that are in both."""
    common = {*map(tuple, a.tolist())} & {*map(tuple, b.tolist())}
    return np.array(sorted(common), dtype=np.int64).reshape(-1, 3)
