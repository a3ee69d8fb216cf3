"""Convex pieces: what every link and object is made of for the checks.

A piece carries its exact convex shape (coal), a conservative cover of spheres for the first look
and its face planes for filling voxels. All in the frame of the piece, metres.
"""

from dataclasses import dataclass
from functools import cache

import coal
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from rf_exp.robots import Robot

COVER_RADIUS_M = 0.06  # spheres of a cover are split until they are smaller than this
COVER_SPHERES = 8  # or until there are this many
CORE_SPHERES = 4
CORE_DEPTHS = (0.0, 0.2, 0.35, 0.5, 0.65)  # of the way from the middle to the vertices: where they may be


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex piece of a body."""

    vertices: NDArray[np.float64]  # (V, 3)
    planes: NDArray[np.float64]  # (F, 4): unit normal n and offset d with n.x + d <= 0 inside
    corners: NDArray[np.float64]  # (8, 3) of the bounding box
    centre: NDArray[np.float64]  # (3,) of the bounding sphere
    radius_m: float
    cover: NDArray[np.float64]  # (COVER_SPHERES, 4): centre and radius; the last ones repeat the first
    core: NDArray[np.float64]  # (CORE_SPHERES, 4): centre and radius of spheres inside
    shape: coal.Convex

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> "Piece":
        """The piece of a convex mesh."""
        vertices = np.asarray(mesh.vertices, dtype=float)
        hull = ConvexHull(vertices)
        centre, radius_m = enclosing_sphere(vertices)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        corners = np.array([np.where(upper, high, low) for upper in np.ndindex(2, 2, 2)])
        return Piece(
            vertices=vertices,
            planes=_distinct(hull.equations),
            corners=corners,
            centre=centre,
            radius_m=radius_m,
            cover=cover(vertices),
            core=core(vertices, hull.equations),
            shape=_coal(vertices),
        )


def enclosing_sphere(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """A small sphere that holds all points (K, 3): centre and radius (Badoiu and Clarkson's steps)."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 60):
        farthest = points[np.argmax(np.sum((points - centre) ** 2, axis=1))]
        centre = centre + (farthest - centre) / (step + 1)
    return centre, float(np.sqrt(np.max(np.sum((points - centre) ** 2, axis=1)))) + 1e-9


def cover(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spheres (COVER_SPHERES, 4) whose union holds the convex hull of the vertices.

    The hull is cut by planes into convex cells; the sphere round the corners of a convex cell holds
    the cell, so no part of the hull is left out.
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
    """Spheres (CORE_SPHERES, 4) inside the convex hull: the largest one, then those that stick out."""
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


def _distinct(equations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Face planes without the repeats that a triangulated flat face brings."""
    _, first = np.unique(np.round(equations, 6), axis=0, return_index=True)
    return equations[np.sort(first)]


def _coal(vertices: NDArray[np.float64]) -> coal.Convex:
    mesh = trimesh.convex.convex_hull(vertices)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for corner in np.asarray(mesh.vertices):
        points.append(corner)
    for a, b, c in mesh.faces.tolist():
        faces.append(coal.Triangle(a, b, c))
    return coal.Convex(points, faces)


@cache
def arm_pieces(robot: Robot) -> tuple[Piece, ...]:
    """The pieces of an arm, in the order of its links."""
    hulls = robot.hulls
    return tuple(Piece.of(hulls[link]) for link in robot.links)
