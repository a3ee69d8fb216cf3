"""Covers, planes and exact shapes of pieces contain the whole convex hull."""

import coal
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from rf_exp.geometry import Piece
from rf_exp.geometry.swept import CORE_SPHERES, COVER_SPHERES, arm_pieces, asset_pieces, enclosing_sphere
from rf_exp.robots import DEFAULT
from rf_exp.tasks import assets

PIECES: list[tuple[str, Piece]] = [
    *zip(DEFAULT.links, arm_pieces(DEFAULT), strict=True),
    *(
        (f"{name}{k}", piece)
        for name in assets.available()
        for k, piece in enumerate(asset_pieces(assets.load(name))[:4])
    ),
]
all_pieces = pytest.mark.parametrize(
    "piece", [piece for _, piece in PIECES], ids=[name for name, _ in PIECES]
)


def sample_points(piece: Piece, count: int, rng: np.random.Generator):
    """Random points of the hull, weighted towards few corners so that edges and corners are sampled, too."""
    weights = rng.dirichlet(np.full(len(piece.vertices), 0.05), count)
    return np.concatenate([weights @ piece.vertices, piece.vertices])


@pytest.mark.slow
@all_pieces
def test_the_cover_and_the_sphere_contain_every_point_of_the_hull(piece):
    points = sample_points(piece, 4000, np.random.default_rng(0))
    assert len(piece.cover) == COVER_SPHERES
    distances = np.linalg.norm(points[:, None] - piece.cover[None, :, :3], axis=2) - piece.cover[:, 3]
    assert distances.min(axis=1).max() <= 1e-9
    assert np.linalg.norm(points - piece.centre, axis=1).max() <= piece.radius_m + 1e-9


@all_pieces
def test_the_core_is_inside_the_hull(piece):
    directions = np.random.default_rng(3).normal(size=(200, 1, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    assert len(piece.core) == CORE_SPHERES
    surface = (piece.core[:, :3] + directions * piece.core[:, 3:]).reshape(-1, 3)
    assert (surface @ piece.planes[:, :3].T + piece.planes[:, 3]).max() <= 1e-6
    assert piece.core[0, 3] > 0


@all_pieces
def test_the_planes_bound_every_point_and_touch_the_hull(piece):
    points = sample_points(piece, 500, np.random.default_rng(1))
    heights = points @ piece.planes[:, :3].T + piece.planes[:, 3]
    assert heights.max() <= 1e-6
    assert heights.max(axis=0) == pytest.approx(0.0, abs=1e-6)


@all_pieces
def test_the_exact_shape_has_the_size_of_the_hull(piece):
    probe, request, result = coal.Sphere(0.001), coal.DistanceRequest(), coal.DistanceResult()
    for direction in np.random.default_rng(2).normal(size=(20, 3)):
        direction = direction / np.linalg.norm(direction)
        # 1 m away: the distance is at least that to the plane through the extreme point.
        far = piece.centre + direction
        result.clear()
        gap = coal.distance(
            piece.shape,
            coal.Transform3s(np.eye(3), np.zeros(3)),
            probe,
            coal.Transform3s(np.eye(3), far),
            request,
            result,
        )
        assert gap >= (direction @ far) - (piece.vertices @ direction).max() - 0.001 - 1e-6
        nearest_vertex = np.linalg.norm(piece.vertices - far, axis=1).min()
        assert gap <= nearest_vertex - 0.001 + 1e-6


def test_the_enclosing_sphere_of_a_cube_is_nearly_minimal():
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    centre, radius_m = enclosing_sphere(corners)
    assert centre == pytest.approx([0.5, 0.5, 0.5], abs=0.02)
    assert np.sqrt(3) / 2 <= radius_m <= 1.03 * np.sqrt(3) / 2


def test_a_piece_keeps_the_volume_of_its_mesh():
    for piece in arm_pieces(DEFAULT):
        low, high = piece.corners.min(axis=0), piece.corners.max(axis=0)
        assert 0.2 * np.prod(high - low) < ConvexHull(piece.vertices).volume <= np.prod(high - low)
