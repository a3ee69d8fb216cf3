"""Closed-form inverse kinematics of the Panda and of the xArm7: all postures that put the TCP at a pose.

Both have a redundant joint and differ only in lengths and in the zeros of their joints. Given the last joint,
the wrist follows from the pose and the bend of the elbow from the distance between wrist and shoulder; the
elbow lies on a circle about the line between them, at the two points where the fifth axis is perpendicular to
the sixth (He and Liu 2021, "Analytical inverse kinematics for Franka Emika Panda"). Frames are those of
Franka's control interface documentation (Craig's convention).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.transforms import wrap_rad

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

BRANCHES = 8  # bend of the elbow x its side on the circle x sign of the second joint
OPPOSITE_BRANCH = np.arange(BRANCHES) ^ 1  # the branch in which an arm continues beyond an upright shoulder

_SIDES = np.array([1.0, -1.0])
NEAR_RAD, STEP_RAD = 0.3, 0.02  # largest change and first step from the last joint of a tool pointing down
SECANT_STEPS, RESIDUAL_TOLERANCE = 3, 1e-6  # steps of the secant method, and tolerance of its residual

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Lengths:
    """Lengths in m of an arm with an elbow axis that is offset from the upper and from the lower arm."""

    shoulder_m: float  # height above the base
    upper_m: float
    lower_m: float
    upper_offset_m: float  # offset of the elbow axis from the upper arm
    lower_offset_m: float  # offset of the elbow axis from the lower arm
    wrist_m: float  # between the sixth and the seventh axis
    flange_to_tcp_m: float  # along the seventh axis, from the foot of the offset `wrist_m` to the TCP

    @cached_property
    def elbow(self) -> Floats:
        """(2,) from the shoulder, across and along the upper arm."""
        return np.array([self.upper_offset_m, self.upper_m])

    @cached_property
    def wrist(self) -> Floats:
        """(2,) from the elbow of a straight arm, across and along the lower arm."""
        return np.array([-self.lower_offset_m, self.lower_m])

    @cached_property
    def ends_m(self) -> tuple[np.floating, np.floating]:
        """Distances from the elbow axis to shoulder and wrist."""
        return np.linalg.norm(self.elbow), np.linalg.norm(self.wrist)

    @cached_property
    def straight_rad(self) -> float:
        return np.arctan2(*self.wrist[::-1]) - np.arctan2(*self.elbow[::-1])


PANDA = Lengths(0.333, 0.316, 0.384, 0.0825, 0.0825, 0.088, 0.2104)  # Franka's documentation
XARM7 = Lengths(0.267, 0.293, 0.3425, 0.0525, 0.0775, 0.076, 0.2004)  # its URDF, with the Panda's gripper


def postures(
    base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats, lengths: Lengths = PANDA
) -> Floats:
    """Joints (..., BRANCHES, 7) rad for TCP poses (..., 4, 4) and the angle of the last joint (...).

    Leading axes are broadcast against one another. A branch that does not exist or leaves the limits (2, 7)
    is NaN. Neighbouring poses have neighbouring postures in the same branch, up to `OPPOSITE_BRANCH`.
    """
    pose, last = np.asarray(base_from_tcp, dtype=float), np.asarray(last_rad, dtype=float)
    # Vectors are (3, ...) here: NumPy is several times faster along long rows than along three components.
    pose = np.broadcast_to(pose, (*np.broadcast_shapes(pose.shape[:-2], last.shape), 4, 4))
    x, y, z, position = np.ascontiguousarray(np.moveaxis(pose[..., :3, :], (-1, -2), (0, 1)))
    x6, wrist = _wrist(lengths, x, y, z, position, last)
    reach = _length(wrist)
    joints = np.full((7, *reach.shape, 2, 2, 2), np.nan)  # bend, side, sign
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = _bend(lengths, reach)
        for k, elbow in enumerate((-bend - lengths.straight_rad, bend - lengths.straight_rad)):
            if (elbow <= limits_rad[1, 3]).any():  # the other bend is seldom within the limits
                _fill(lengths, joints[..., k, :, :], elbow, wrist / reach, reach, x6, z)
        joints[6] = last[..., None, None, None]
        low, high = (limits.reshape(-1, *[1] * (joints.ndim - 1)) for limits in limits_rad)
        within_limits = ((joints >= low) & (joints <= high)).all(axis=0)
    joints[:, ~within_limits] = np.nan
    return np.moveaxis(joints.reshape(7, *reach.shape, BRANCHES), 0, -1)


class ClosedForm:
    """`rf_exp.robots.Inverse` of the Panda."""

    branches, opposite_branch, lengths = BRANCHES, OPPOSITE_BRANCH, PANDA

    def __init__(self, _: "Robot") -> None: ...

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        return postures(base_from_tcp, last_rad, limits_rad, self.lengths)

    def preferred_last_rad(self, base_from_tcp: Floats) -> Floats:
        """See `Inverse`: the angle that puts the arm into a vertical plane, where the third joint is zero.

        With the upper arm almost vertical, the first and the third joint turn about nearly the same axis, and
        only such a posture is reached quickly. Found by the secant method, starting from the angle that is
        exact for a tool pointing straight down; that angle where none is found within NEAR_RAD of it.
        """
        pose = base_from_tcp
        outward = pose[..., :2, 3] / np.linalg.norm(pose[..., :2, 3], axis=-1, keepdims=True)
        outward_in_tool = np.einsum("...i,...ij->...j", outward, pose[..., :2, :2])
        initial = np.pi / 4 - np.arctan2(outward_in_tool[..., 1], outward_in_tool[..., 0])
        x, y, z, position = np.ascontiguousarray(np.moveaxis(pose[..., :3, :], (-1, -2), (0, 1)))
        previous, last = initial, initial + STEP_RAD
        with np.errstate(invalid="ignore", divide="ignore"):
            previous_residual, residual = (
                _out_of_plane(self.lengths, x, y, z, position, angle) for angle in (previous, last)
            )
            for _ in range(SECANT_STEPS):
                change = np.nan_to_num(residual * (last - previous) / (residual - previous_residual))
                previous, previous_residual, last = last, residual, last - change
                residual = _out_of_plane(self.lengths, x, y, z, position, last)
            converged = (np.abs(residual) < RESIDUAL_TOLERANCE) & (np.abs(last - initial) < NEAR_RAD)
        return wrap_rad(np.where(converged, last, initial))


class XArm7ClosedForm(ClosedForm):
    """`rf_exp.robots.Inverse` of the xArm7. Its q4 is the Panda's plus pi, its q6 is pi minus the Panda's."""

    lengths = XARM7

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        low, high = limits = limits_rad.copy()
        limits[:, 3] -= np.pi
        low[5], high[5] = np.pi - high[5], np.pi - low[5]
        joints = super().postures(base_from_tcp, last_rad, limits)
        joints[..., 3] += np.pi
        joints[..., 5] = np.pi - joints[..., 5]
        return joints


def _out_of_plane(
    lengths: Lengths, x: Floats, y: Floats, z: Floats, position: Floats, last: Floats
) -> Floats:
    """Residual (...) that is zero for an arm in a vertical plane: the fifth axis projected on the sixth."""
    x6, wrist = _wrist(lengths, x, y, z, position, last)
    reach = _length(wrist)
    elbow = -_bend(lengths, reach) - lengths.straight_rad
    lateral, _, fifth_along, fifth_across = _plane(lengths, np.cos(elbow), np.sin(elbow), reach)
    line = wrist / reach
    up = -line[2] * line
    up[2] += 1
    across = np.where(lateral < 0, -1.0, 1.0) * up / _length(up)  # with the elbow above the line
    return _dot(fifth_along * line + fifth_across * across, _cross(z, x6))


def _wrist(
    lengths: Lengths, x: Floats, y: Floats, z: Floats, position: Floats, last: Floats
) -> tuple[Floats, Floats]:
    """Unit vector from the sixth axis to the seventh, and shoulder to wrist in m: both (3, ...)."""
    turn = np.pi / 4 - last  # the gripper is mounted at 45 degrees
    x6 = np.cos(turn) * x + np.sin(turn) * y
    wrist = position - lengths.flange_to_tcp_m * z - lengths.wrist_m * x6
    wrist[2] -= lengths.shoulder_m
    return x6, wrist


def _bend(lengths: Lengths, reach: Floats) -> Floats:
    """Bend (...) of the elbow in rad, from the distance between shoulder and wrist."""
    upper_m, lower_m = lengths.ends_m
    return np.arccos((reach**2 - upper_m**2 - lower_m**2) / (2 * (upper_m * lower_m)))


def _plane(
    lengths: Lengths, cos: Floats, sin: Floats, reach: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Components in the plane of the arm, for cosine and sine of the fourth joint: the line from shoulder to
    wrist, across and along the upper arm; the fifth axis, along and across that line.
    """
    elbow, wrist = lengths.elbow, lengths.wrist
    lateral = (elbow[0] + cos * wrist[0] - sin * wrist[1]) / reach
    along = (elbow[1] + sin * wrist[0] + cos * wrist[1]) / reach
    return lateral, along, cos * along - sin * lateral, cos * lateral + sin * along


def _fill(
    lengths: Lengths, joints: Floats, elbow: Floats, line: Floats, reach: Floats, x6: Floats, z: Floats
) -> None:
    """Writes the first six joints into `found` (7, ..., side, sign), given the fourth (...).

    `line` (3, ...) points from the shoulder to the wrist, which are `reach` (...) m apart.
    """
    z6 = _cross(z, x6)  # the sixth axis
    cos, sin = np.cos(elbow), np.sin(elbow)
    lateral, along, fifth_along, fifth_across = _plane(lengths, cos, sin, reach)
    on_line = _dot(line, z6)
    offset = z6 - on_line * line
    norm = _length(offset)
    first = offset / norm
    cosine = -fifth_along * on_line / (fifth_across * norm)  # of the rotation of the plane about the line
    sine = np.sqrt(1 - cosine**2)[..., None] * _SIDES
    across = cosine[..., None] * first[..., None] + sine * _cross(line, first)[..., None]  # (3, ..., side)
    line, lateral, along = line[..., None], lateral[..., None], along[..., None]
    z3 = along * line + lateral * across
    x3 = lateral * line - along * across
    z5 = fifth_along[..., None] * line + fifth_across[..., None] * across
    x4 = cos[..., None] * x3 + sin[..., None] * z3
    x6, z6, z = x6[..., None], z6[..., None], z[..., None]
    joints[3] = elbow[..., None, None]
    joints[4] = np.arctan2(_dot(z6, x4), _dot(z6, _cross(x3, z3)))[..., None]
    along_out = z5[0] * z[0] + z5[1] * z[1] + z5[2] * z[2]
    sixth = np.arctan2(_dot(z5, x6), -along_out)
    joints[5] = np.where(sixth < -np.pi / 2, sixth + 2 * np.pi, sixth)[..., None]
    z3, x3 = z3[..., None], x3[..., None]  # (3, ..., side, sign)
    shoulder = np.arctan2(_SIDES * z3[1], _SIDES * z3[0])
    cos, sin = np.cos(shoulder), np.sin(shoulder)
    tilt = cos * z3[0] + sin * z3[1]
    joints[0] = shoulder
    joints[1] = np.arctan2(tilt, z3[2])
    x2 = z3[2] * (cos * x3[0] + sin * x3[1]) - tilt * x3[2]
    joints[2] = np.arctan2(cos * x3[1] - sin * x3[0], x2)


def _dot(a: Floats, b: Floats) -> Floats:
    """Dot product (...) of vectors (3, ...). The bytes of episodes depend on the order of the additions."""
    return (a[0] * b[0] + a[2] * b[2]) + a[1] * b[1]


def _length(a: Floats) -> Floats:
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
