"""Vertices of round shapes built from convex pieces."""

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray


def circle(radius_m: float, z_m: float, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vertices (K, 3) on a circle about z, at angles (K,) rad."""
    return np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(len(angles), z_m)])


def ring(
    inner_m: float, outer_m: float, low_m: float, high_m: float, count: int
) -> list[NDArray[np.float64]]:
    """Vertices (8, 3) of each of the convex pieces that form a tube about z between two heights."""
    pieces = [
        product(edges, (inner_m, outer_m), (low_m, high_m))
        for edges in pairwise(np.linspace(0, 2 * np.pi, count + 1))
    ]
    return [
        np.array([(r * np.cos(angle), r * np.sin(angle), z) for angle, r, z in corners]) for corners in pieces
    ]
