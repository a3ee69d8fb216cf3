"""Rigid transforms as (4, 4) float64 matrices named `a_from_b`: p_a = a_from_b @ p_b.

Positions in metres, angles in radians unless a name says `_deg`, quaternions wxyz.
"""

from collections.abc import Sequence
from functools import cache
from math import atan2, hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]
Direction = NDArray[np.floating] | Sequence[float]  # (3,)


def transform(position_m: ArrayLike = (0.0, 0.0, 0.0), rotation: Rotation | None = None) -> Matrix:
    """The (4, 4) matrix of a position (3,) and a rotation."""
    matrix = np.eye(4)
    matrix[:3, 3] = position_m
    if rotation is not None:
        matrix[:3, :3] = rotation.as_matrix()
    return matrix


def planar(x_m: float, y_m: float, yaw_rad: float, z_m: float = 0.0) -> Matrix:
    """An upright pose at (x, y, z), rotated by yaw about the vertical."""
    return transform((x_m, y_m, z_m), Rotation.from_euler("z", yaw_rad))


def rotation_matrix(rotation_vector: ArrayLike) -> Matrix:
    """The rotation by a rotation vector (3,), in rad."""
    return transform(rotation=Rotation.from_rotvec(rotation_vector))


@cache
def equal_rotations(count: int) -> tuple[Matrix, ...]:
    """`count` rotations about the z axis, evenly spaced from 0 over a full turn."""
    angles = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    return tuple(transform(rotation=Rotation.from_euler("z", angle)) for angle in angles)


def from_axes(position_m: ArrayLike, *, z: ArrayLike, y: ArrayLike) -> Matrix:
    """A pose whose z axis points along `z` and whose y axis lies closest to `y`. ValueError if parallel."""
    z_axis = np.asarray(z, dtype=float) / np.linalg.norm(z)
    y_axis = np.asarray(y, dtype=float) - np.dot(y, z_axis) * z_axis
    length = np.linalg.norm(y_axis)
    if length < 1e-9:
        raise ValueError(f"axes z={z} and y={y} are parallel")
    y_axis /= length
    matrix = transform(position_m)
    matrix[:3, :3] = np.column_stack([np.cross(y_axis, z_axis), y_axis, z_axis])
    return matrix


def quaternion(matrix: Matrix) -> NDArray[np.float64]:
    """The unit quaternion (w, x, y, z) of the rotation part of (4, 4), or one each of (T, 4, 4)."""
    return Rotation.from_matrix(matrix[..., :3, :3]).as_quat(scalar_first=True)


def position_and_quaternion(matrix: Matrix) -> list[float]:
    """(x, y, z, qw, qx, qy, qz) of one (4, 4), ten times as fast as `quaternion`, which is for many."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = matrix.tolist()
    trace = a + e + i
    largest = max(a, e, i, trace)  # the best conditioned of four ways
    if trace == largest:
        components = (1 + trace, h - f, c - g, d - b)
    elif a == largest:
        components = (h - f, 1 - trace + 2 * a, b + d, c + g)
    elif e == largest:
        components = (c - g, b + d, 1 - trace + 2 * e, f + h)
    else:
        components = (d - b, c + g, f + h, 1 - trace + 2 * i)
    norm, (qw, qx, qy, qz) = hypot(*components), components
    return [x, y, z, qw / norm, qx / norm, qy / norm, qz / norm]


def from_quaternion(poses: NDArray[np.floating]) -> NDArray[np.float64]:
    """Poses (..., 4, 4) of positions in m with quaternions w, x, y, z (..., 7)."""
    matrices = np.zeros((*poses.shape[:-1], 4, 4))
    rotations = Rotation.from_quat(poses[..., 3:].reshape(-1, 4), scalar_first=True)
    matrices[..., :3, :3] = rotations.as_matrix().reshape(*poses.shape[:-1], 3, 3)
    matrices[..., :3, 3] = poses[..., :3]
    matrices[..., 3, 3] = 1.0
    return matrices


def inverse(matrix: Matrix) -> Matrix:
    """The inverse, `b_from_a` of `a_from_b`; exact for rigid transforms."""
    result = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result


def apply(matrix: Matrix, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (..., 3) transformed by (4, 4)."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def transform_by_poses(poses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (K, 3), or (..., K, 3), in the frames of poses (..., 4, 4) to the outer frame: (..., K, 3)."""
    return points @ poses[..., :3, :3].swapaxes(-1, -2) + poses[..., None, :3, 3]


def wrap_rad(angles: ArrayLike) -> NDArray[np.float64]:
    """Angles (...) wrapped to [-pi, pi)."""
    return (np.asarray(angles) + np.pi) % (2 * np.pi) - np.pi


def angle_between_rad(a: Direction, b: Direction) -> float:
    """The angle between two directions (3,), in [0, pi]."""
    ax, ay, az = a.tolist() if isinstance(a, np.ndarray) else a
    bx, by, bz = b.tolist() if isinstance(b, np.ndarray) else b
    sine = hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    return atan2(sine, ax * bx + ay * by + az * bz)


def interpolate(a: Matrix, b: Matrix, fraction: ArrayLike) -> NDArray[np.float64]:
    """Poses (..., 4, 4) at fractions (...) of the way from `a` to `b`: straight line, shortest rotation."""
    fractions = np.asarray(fraction, dtype=float)
    poses = np.broadcast_to(a, (*fractions.shape, 4, 4)).copy()
    poses[..., :3, 3] += fractions[..., None] * (b[:3, 3] - a[:3, 3])
    if not np.array_equal(a[:3, :3], b[:3, :3]):  # most straight motions do not rotate
        rotation_vector = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
        rotations = Rotation.from_rotvec((fractions[..., None] * rotation_vector).reshape(-1, 3)).as_matrix()
        poses[..., :3, :3] = a[:3, :3] @ rotations.reshape(*fractions.shape, 3, 3)
    return poses
