"""The table on which all tasks stand, and what does not lie on it."""

import numpy as np
from numpy.typing import NDArray

TABLE_M = (2.6, 2.8, 0.06)  # extents along x, y, z; the top is at z = 0
TABLE_CENTRE_M = (0.1, 0.0)


def beyond_edge(points: NDArray[np.float64]) -> tuple[float, str]:
    """By how many m points (K, 2 or 3) lie beyond an edge at most, and which; 0 or less: none does."""
    half, centre = np.array(TABLE_M[:2]) / 2, np.array(TABLE_CENTRE_M)
    ends = np.stack([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])  # (2, 2) lowest and highest
    edges = np.stack([centre - half, centre + half])
    beyond = (ends - edges) * np.array([[-1.0], [1.0]])
    side, axis = (int(each) for each in np.unravel_index(beyond.argmax(), beyond.shape))
    return float(beyond[side, axis]), f"{'xy'[axis]} = {edges[side, axis]:g} m"
