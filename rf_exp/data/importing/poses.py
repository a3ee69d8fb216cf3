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

ABSOLUTE_TOLERANCE = 1e-4  # largest difference of equal values: m, entries of a rotation, px, degrees
RELATIVE_TOLERANCE = 1e-3  # tolerance for square pixels (relative), for rotations and unit quaternions


class CameraPose(NamedTuple):
    """Field of view and pose of a camera."""

    fov_deg: float  # vertical
    world_from_camera: Matrix  # (4, 4): x right, y down, z forward


def base_pose(poses: NDArray[np.float64]) -> Matrix | None:
    """Base pose (4, 4) from poses (T, 7) in m with quaternions; None if they move, tilt or are invalid."""
    if (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > RELATIVE_TOLERANCE).any():
        return None
    bases = from_quaternion(poses)
    return (
        bases[0]
        if bases[0, 2, 2] > 1 - ABSOLUTE_TOLERANCE and np.ptp(bases, axis=0).max() < ABSOLUTE_TOLERANCE
        else None
    )


def camera_pose(parameters: Mapping[str, NDArray[np.float64]], size_px: tuple[int, int]) -> CameraPose | str:
    """Field of view and pose of a camera with pictures of this height and width, or why they are unknown.

    `parameters` (T, ...) are `intrinsic_cv` (3, 3) px, and `extrinsic_cv` (3, 4), camera_from_world
    with axes of OpenCV, or `cam2world_gl` (4, 4), world_from_camera with those of OpenGL, or both.
    """
    if any(
        not len(values) or np.ptp(values, axis=0).max() > ABSOLUTE_TOLERANCE for values in parameters.values()
    ):
        return "it moves, or its parameters are empty"
    poses = []
    if "extrinsic_cv" in parameters:
        poses.append(inverse(np.vstack([parameters["extrinsic_cv"][0], [0, 0, 0, 1]])))
    if "cam2world_gl" in parameters:
        poses.append(parameters["cam2world_gl"][0] @ GL_FROM_CV)
    if not poses or "intrinsic_cv" not in parameters:
        return "sensor_param does not say it"
    for pose in poses:
        rotation = pose[:3, :3]
        if (
            np.abs(rotation @ rotation.T - np.eye(3)).max() > RELATIVE_TOLERANCE
            or np.linalg.det(rotation) < 0
        ):
            return "its pose is no rotation and translation"
    if np.abs(poses[0] - poses[-1]).max() > RELATIVE_TOLERANCE:
        return "extrinsic_cv and cam2world_gl contradict one another"
    (fx, skew, cx), (_, fy, cy), _ = parameters["intrinsic_cv"][0].tolist()
    height, width = size_px
    if abs(cx - width / 2) > 0.5 or abs(cy - height / 2) > 0.5:
        return "its axis does not go through the middle of the picture"
    if fy <= 0 or abs(fx - fy) > RELATIVE_TOLERANCE * fy or abs(skew) > RELATIVE_TOLERANCE * fy:
        return "its pixels are not square"
    return CameraPose(float(np.rad2deg(2 * np.arctan(height / 2 / fy))), poses[0])


def camera_spec(pose: CameraPose) -> CameraSpec:
    """The camera specification, as in a task's configuration, with this pose and field of view."""
    world_from_camera = pose.world_from_camera
    eye_m, target_m = world_from_camera[:3, 3], world_from_camera[:3, 3] + world_from_camera[:3, 2]
    spec = CameraSpec((*eye_m.tolist(),), (*target_m.tolist(),), pose.fov_deg)
    rotation_deg = Rotation.from_matrix(
        spec.world_from_camera[:3, :3].T @ world_from_camera[:3, :3]
    ).as_rotvec(degrees=True)
    return (
        replace(spec, turn_deg=(*rotation_deg.tolist(),))
        if np.abs(rotation_deg).max() > ABSOLUTE_TOLERANCE
        else spec
    )


def planar_pose(world_from_base: Matrix) -> dict[str, float]:
    """Pose of an upright base (4, 4), as in a task's configuration."""
    x, y, z = world_from_base[:3, 3].tolist()
    yaw_deg = float(np.rad2deg(np.arctan2(world_from_base[1, 0], world_from_base[0, 0])))
    return {"x_m": x, "y_m": y, "yaw_deg": yaw_deg} | ({"z_m": z} if abs(z) > ABSOLUTE_TOLERANCE else {})
