"""How high above the table a body is."""

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry.swept import Swept

PRESSED_M = 0.001  # a load may lie on the table, but not be pressed in farther than this


def lowest_m(body: Swept) -> NDArray[np.float64]:
    """(P,) lowest point of what must stay above the table: all links but the bolted base, and loads.

    A load may lie on the table, so it counts as low only where it is pressed more than `PRESSED_M` in.
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
