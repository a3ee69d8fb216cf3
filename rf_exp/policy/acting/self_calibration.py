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

from rf_exp.transforms import rotation_matrix

# Standard deviations: direction (rad, each axis), position (m, each axis), log scale of the field of view.
PRIOR_STD = np.array([0.05] * 3 + [0.03] * 3 + [0.03])
MOST_EVALUATIONS = 4  # evaluations of a fit, which starts from the last one
PIXEL_STD = 1.0  # of a gripper detection
# Least motion of a gripper: detections of one that stands still err alike, and count once.
LEAST_MOTION_M = 0.02


@dataclass
class CameraEstimate:
    """Estimate of one of several cameras with pictures side by side, see `rf_exp.policy.inputs.pictures`."""

    usual_rays: NDArray[np.float64]  # (3, 4) its rays as usually mounted
    centre: NDArray[np.float64]  # (2,) of its part of the picture
    size_px: NDArray[np.float64]  # (2,) of the whole picture
    _points: list[NDArray[np.float64]] = field(default_factory=list)  # each (n, 3) m
    _places: list[NDArray[np.float64]] = field(default_factory=list)  # each (n, 2) from 0 to 1
    _displacement: NDArray[np.float64] = field(
        default_factory=lambda: np.zeros(len(PRIOR_STD))
    )  # in PRIOR_STD

    @property
    def rays(self) -> NDArray[np.float64]:
        """Rays (3, 4) by the detections so far."""
        return self._rays(self._displacement)

    def add_detections(self, points: NDArray[np.float64], places: NDArray[np.float64]) -> None:
        """Add grippers at points (n, 3), detected at places (n, 2), unless they are where they were last."""
        if self._points and np.abs(points - self._points[-1]).max() < LEAST_MOTION_M:
            return
        self._points.append(points)
        self._places.append(places)
        points, places = np.concatenate(self._points), np.concatenate(self._places)

        def residuals(displacement: NDArray[np.float64]) -> NDArray[np.float64]:
            rays = self._rays(displacement)
            projected = (points - rays[:, 3]) @ np.linalg.inv(rays[:, :3]).T
            errors = (projected[:, :2] / projected[:, 2:] - places) * self.size_px / PIXEL_STD
            return np.concatenate([errors.ravel(), displacement])

        # Robust loss: a wrong detection is far off, and counts for little.
        fit = least_squares(
            residuals, self._displacement, loss="soft_l1", f_scale=2.0, max_nfev=MOST_EVALUATIONS
        )
        self._displacement = fit.x

    def _rays(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        rotation, shift, (widening,) = np.split(PRIOR_STD * displacement, (3, 6))
        directions = self.usual_rays[:, :3]
        axis = directions @ (*self.centre, 1.0)
        axis = axis / np.linalg.norm(axis)
        across = directions - np.outer(axis, axis @ directions)
        directions = directions + (np.exp(widening) - 1) * across
        return np.column_stack(
            [rotation_matrix(rotation)[:3, :3] @ directions, self.usual_rays[:, 3] + shift]
        )


def camera_estimates(usual_rays: NDArray[np.float64], size_px: Sequence[int]) -> tuple[CameraEstimate, ...]:
    """Estimates of the K cameras of a stream, by usual rays (K, 3, 4) and width and height of pictures."""
    count = len(usual_rays)
    full_size_px = np.array([count * size_px[0], size_px[1]])
    return tuple(
        CameraEstimate(rays, np.array([(row + 0.5) / count, 0.5]), full_size_px)
        for row, rays in enumerate(usual_rays)
    )
