"""Closed-form inverse kinematics of Universal Robots' UR5: all postures that put its TCP at a pose.

Three axes of the arm are parallel. The first joint follows from the lateral offset of the wrist, the fifth
from the inclination of the gripper to the plane of the arm, the sixth from its rotation; the rest is a
two-link arm in that plane (Hawkins 2013, "Analytic inverse kinematics for the Universal Robots"). Shoulder,
wrist and elbow have two solutions each. Frames are those of the manufacturer's URDF.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.transforms import from_axes, inverse

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

SHOULDER_M = 0.089159  # height of the second axis above the base
UPPER_M, LOWER_M = 0.425, 0.39225  # lengths of upper and lower arm
BESIDE_M = 0.10915  # lateral offset of the plane of the fifth axis from the first axis
WRIST_M, FLANGE_M = 0.09465, 0.0823  # along the fifth axis to the sixth, along the sixth to the flange
BRANCHES = 8  # side of the shoulder x of the wrist x of the elbow
SINGULAR = 1e-9  # a smaller sine of the fifth joint counts as zero: the fourth and sixth axis are parallel

_SIDES = np.array([1.0, -1.0])
Floats = NDArray[np.float64]


class UR5ClosedForm:
    """`rf_exp.robots.Inverse` of the UR5. Of angles whole turns apart it returns the nearest to rest.

    Where the fifth joint is 0 or 180 degrees, the fourth and the sixth axis are parallel and the sixth joint
    is arbitrary: it is set to the given last joint. Branches are then equal in pairs.
    """

    branches, opposite_branch = BRANCHES, np.arange(BRANCHES)

    def __init__(self, robot: "Robot") -> None:
        at_zero = robot.tcp_pose(np.zeros(robot.dof))
        self._tcp_from_flange = inverse(at_zero) @ _flange_at_zero()
        self._rest = np.array(robot.rest_rad)

    def preferred_last_rad(self, base_from_tcp: Floats) -> Floats:
        """See `Inverse`: the angle at rest, as the arm has no redundant joint."""
        return np.full(np.shape(base_from_tcp)[:-2], self._rest[-1])

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        last = np.asarray(last_rad, dtype=float)
        pose = np.asarray(base_from_tcp, dtype=float) @ self._tcp_from_flange
        shape = np.broadcast_shapes(pose.shape[:-2], last.shape)
        with np.errstate(invalid="ignore"):
            joints = self._solve(pose, last)
            joints += 2 * np.pi * np.round((self._rest - joints) / (2 * np.pi))
            joints += 2 * np.pi * ((joints < limits_rad[0]) - 1.0 * (joints > limits_rad[1]))
            outside = ~((joints >= limits_rad[0]) & (joints <= limits_rad[1])).all(axis=-1)
        joints[outside] = np.nan
        return np.broadcast_to(joints, (*shape, BRANCHES, 6)).copy()

    def _solve(self, base_from_flange: Floats, last: Floats) -> Floats:
        """Joints (..., BRANCHES, 6) rad; NaN where the pose is out of reach.

        In the frame of the arm's plane, x points away from the base and y out of the plane; angles are
        measured from x downwards.
        """
        pose = base_from_flange[..., None, None, None, :, :]
        shoulder, wrist, elbow = _SIDES[:, None, None], _SIDES[:, None], _SIDES
        x, z, position = pose[..., :3, 0], pose[..., :3, 2], pose[..., :3, 3]
        middle = position - FLANGE_M * z  # intersection of the fifth and the sixth axis
        offset_angle = np.arcsin(BESIDE_M / np.hypot(middle[..., 0], middle[..., 1]))
        offset_angle = np.where(shoulder > 0, offset_angle, np.pi - offset_angle)
        first = np.arctan2(middle[..., 1], middle[..., 0]) - offset_angle
        cos, sin = np.cos(first), np.sin(first)

        def in_plane(vector: Floats) -> tuple[Floats, Floats, Floats]:
            """Components along x, downwards and along y."""
            along = cos * vector[..., 0] + sin * vector[..., 1]
            return along, -vector[..., 2], cos * vector[..., 1] - sin * vector[..., 0]

        z_along, z_down, z_lateral = in_plane(z)
        x_along, x_down, x_lateral = in_plane(x)
        sine = wrist * np.hypot(z_along, z_down)
        fifth = np.arctan2(sine, z_lateral)
        # Direction of the sixth axis in the plane, perpendicular to the fifth axis; where the sixth axis is
        # normal to the plane, the direction for which the sixth joint is the given one.
        turned = np.sign(z_lateral) * last[..., None, None, None]
        cos6, sin6 = np.cos(turned), np.sin(turned)
        flat = np.abs(sine) < SINGULAR
        side = np.where(z_lateral < 0, 1.0, -1.0)
        ahead = np.where(flat, side * (cos6 * x_along + sin6 * x_down), z_along * wrist)
        down = np.where(flat, side * (cos6 * x_down - sin6 * x_along), z_down * wrist)
        leaning = np.arctan2(down, ahead)  # sum of the second, third and fourth joint
        cos_, sin_ = np.cos(leaning), np.sin(leaning)
        fifth_along, fifth_down = -sin_, cos_  # the fifth axis
        sixth = np.arctan2(
            -(x_along * fifth_along + x_down * fifth_down),
            np.sin(fifth) * x_lateral - np.cos(fifth) * (x_along * cos_ + x_down * sin_),
        )
        along, below, _ = in_plane(middle)
        along = along - WRIST_M * fifth_along
        below = below + SHOULDER_M - WRIST_M * fifth_down
        cosine = (along**2 + below**2 - UPPER_M**2 - LOWER_M**2) / (2 * UPPER_M * LOWER_M)
        third = elbow * np.arccos(cosine)
        second = np.arctan2(below, along) - np.arctan2(
            LOWER_M * np.sin(third), UPPER_M + LOWER_M * np.cos(third)
        )
        joints = first, second, third, leaning - second - third, fifth, sixth
        stacked = np.stack(np.broadcast_arrays(*joints), axis=-1)
        return stacked.reshape(*stacked.shape[:-4], BRANCHES, 6)


def _flange_at_zero() -> Floats:
    """base_from_flange (4, 4) with all joints at zero: the arm along x, the sixth axis along y."""
    place = UPPER_M + LOWER_M, BESIDE_M + FLANGE_M, SHOULDER_M - WRIST_M
    return from_axes(place, z=(0, 1, 0), y=(0, 0, 1))
