"""Poses of arm bases and cameras from a simulator's recordings."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.data.recordepisode import GL_FROM_CV
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import Matrix, from_quaternion, inverse

SAME = 1e-4  # largest difference of equal values: m, entries of a rotation, px, degrees
SQUARE = 1e-3  # tolerance for square pixels (relative), for rotations and unit quaternions


class Stand(NamedTuple):
    """Field of view and pose of a camera."""

    fov_deg: float  # vertical
    world_from_camera: Matrix  # (4, 4): x right, y down, z forward


def base_of(poses: NDArray[np.float64]) -> Matrix | None:
    """Base pose (4, 4) from poses (T, 7) in m with quaternions; None if they move, tilt or are invalid."""
    if (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > SQUARE).any():
        return None
    found = from_quaternion(poses)
    return found[0] if found[0, 2, 2] > 1 - SAME and np.ptp(found, axis=0).max() < SAME else None


def stand_of(read: Mapping[str, NDArray[np.float64]], size_px: tuple[int, int]) -> Stand | str:
    """Field of view and pose of a camera with pictures of this height and width, or why they are unknown.

    `read` has its parameters (T, ...): `intrinsic_cv` (3, 3) px, and `extrinsic_cv` (3, 4), camera_from_world
    with axes of OpenCV, or `cam2world_gl` (4, 4), world_from_camera with those of OpenGL, or both.
    """
    if any(not len(each) or np.ptp(each, axis=0).max() > SAME for each in read.values()):
        return "it moves, or its parameters are empty"
    poses = []
    if "extrinsic_cv" in read:
        poses.append(inverse(np.vstack([read["extrinsic_cv"][0], [0, 0, 0, 1]])))
    if "cam2world_gl" in read:
        poses.append(read["cam2world_gl"][0] @ GL_FROM_CV)
    if not poses or "intrinsic_cv" not in read:
        return "sensor_param does not say it"
    for pose in poses:
        turn = pose[:3, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > SQUARE or np.linalg.det(turn) < 0:
            return "its pose is no rotation and translation"
    if np.abs(poses[0] - poses[-1]).max() > SQUARE:
        return "extrinsic_cv and cam2world_gl contradict one another"
    (fx, skew, cx), (_, fy, cy), _ = read["intrinsic_cv"][0].tolist()
    height, width = size_px
    if abs(cx - width / 2) > 0.5 or abs(cy - height / 2) > 0.5:
        return "its axis does not go through the middle of the picture"
    if fy <= 0 or abs(fx - fy) > SQUARE * fy or abs(skew) > SQUARE * fy:
        return "its pixels are not square"
    return Stand(float(np.rad2deg(2 * np.arctan(height / 2 / fy))), poses[0])


def spec_of(stand: Stand) -> CameraSpec:
    """The camera specification, as in a task's configuration, with this pose and field of view."""
    pose = stand.world_from_camera
    eye_m, target_m = pose[:3, 3], pose[:3, 3] + pose[:3, 2]
    spec = CameraSpec((*eye_m.tolist(),), (*target_m.tolist(),), stand.fov_deg)
    turn = Rotation.from_matrix(spec.world_from_camera[:3, :3].T @ pose[:3, :3]).as_rotvec(degrees=True)
    return replace(spec, turn_deg=(*turn.tolist(),)) if np.abs(turn).max() > SAME else spec


def planar_of(world_from_base: Matrix) -> dict[str, float]:
    """Pose of an upright base (4, 4), as in a task's configuration."""
    x, y, z = world_from_base[:3, 3].tolist()
    yaw_deg = float(np.rad2deg(np.arctan2(world_from_base[1, 0], world_from_base[0, 0])))
    return {"x_m": x, "y_m": y, "yaw_deg": yaw_deg} | ({"z_m": z} if abs(z) > SAME else {})
