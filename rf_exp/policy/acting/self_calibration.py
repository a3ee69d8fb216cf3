"""Self-calibration: camera poses from detections of the own gripper, whose pose follows from the joints.

Each observation without calibration gives the place of an own gripper in the picture, and kinematics its
point. A camera's direction, position and field of view are fitted to all of an episode: the most probable
ones, for displacements from its usual pose of `PRIOR_STD` and detection errors of `PIXEL_STD`. The gripper is
a calibration target that goes where the work is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rf_exp.transforms import rotated

# Standard deviations: direction (rad, each axis), position (m, each axis), log scale of the field of view.
PRIOR_STD = np.array([0.05] * 3 + [0.03] * 3 + [0.03])
MOST_EVALUATIONS = 4  # evaluations of a fit, which starts from the last one
PIXEL_STD = 1.0  # of a gripper detection
APART_M = 0.02  # least motion of a gripper: detections of one that stands still err alike, and count once


@dataclass
class CameraEstimate:
    """Estimate of one of several cameras with pictures side by side, see `rf_exp.policy.inputs.pictures`."""

    usual: NDArray[np.float64]  # (3, 4) its rays as usually mounted
    centre: NDArray[np.float64]  # (2,) of its part of the picture
    size_px: NDArray[np.float64]  # (2,) of the whole picture
    _points: list[NDArray[np.float64]] = field(default_factory=list)  # each (n, 3) m
    _places: list[NDArray[np.float64]] = field(default_factory=list)  # each (n, 2) from 0 to 1
    _moved: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(PRIOR_STD)))  # in PRIOR_STD

    @property
    def rays(self) -> NDArray[np.float64]:
        """Rays (3, 4) by the detections so far."""
        return self._rays(self._moved)

    def see(self, points: NDArray[np.float64], places: NDArray[np.float64]) -> None:
        """Add grippers at points (n, 3), detected at places (n, 2), unless they are where they were last."""
        if self._points and np.abs(points - self._points[-1]).max() < APART_M:
            return
        self._points.append(points)
        self._places.append(places)
        points, places = np.concatenate(self._points), np.concatenate(self._places)

        def off(moved: NDArray[np.float64]) -> NDArray[np.float64]:
            rays = self._rays(moved)
            seen = (points - rays[:, 3]) @ np.linalg.inv(rays[:, :3]).T
            misses = (seen[:, :2] / seen[:, 2:] - places) * self.size_px / PIXEL_STD
            return np.concatenate([misses.ravel(), moved])

        # Robust loss: a wrong detection is far off, and counts for little.
        fit = least_squares(off, self._moved, loss="soft_l1", f_scale=2.0, max_nfev=MOST_EVALUATIONS)
        self._moved = fit.x

    def _rays(self, moved: NDArray[np.float64]) -> NDArray[np.float64]:
        turn, shift, (wider,) = np.split(PRIOR_STD * moved, (3, 6))
        directions = self.usual[:, :3]
        ahead = directions @ (*self.centre, 1.0)
        ahead = ahead / np.linalg.norm(ahead)
        across = directions - np.outer(ahead, ahead @ directions)
        directions = directions + (np.exp(wider) - 1) * across
        return np.column_stack([rotated(turn)[:3, :3] @ directions, self.usual[:, 3] + shift])


def estimates(usual: NDArray[np.float64], size_px: Sequence[int]) -> tuple[CameraEstimate, ...]:
    """Estimates of the K cameras of a stream, by usual rays (K, 3, 4) and width and height of pictures."""
    count = len(usual)
    whole = np.array([count * size_px[0], size_px[1]])
    return tuple(
        CameraEstimate(rays, np.array([(row + 0.5) / count, 0.5]), whole) for row, rays in enumerate(usual)
    )
