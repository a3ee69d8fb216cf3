"""Closed-form inverse kinematics of the Panda: all postures that put its TCP at a pose.

The arm has a joint to spare. With the last joint given, what is left is geometry: the wrist follows from
the pose, the bend of the elbow from the distance between wrist and shoulder, and the elbow lies on a
circle about the line between them, at the two places where the fifth axis is square to the sixth (He and
Liu 2021, "Analytical inverse kinematics for Franka Emika Panda"). Frames and lengths are those of
Franka's control interface documentation (Craig's convention).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

SHOULDER_M = 0.333  # height of the shoulder above the base
UPPER_M, LOWER_M, BEND_M = 0.316, 0.384, 0.0825  # of the arm; the elbow's axis lies beside both
WRIST_M = 0.088  # between the sixth and the seventh axis
FLANGE_TO_TCP_M = 0.2104  # along the seventh axis, from where the wrist is square to it to the TCP
BRANCHES = 8  # bend of the elbow x its place on the circle x sign of the second joint
OTHER_SIGN = np.arange(BRANCHES) ^ 1  # the branch beyond an upright shoulder, where an arm crosses over

_ELBOW = np.array([BEND_M, UPPER_M])  # from the shoulder: beside the upper arm, along it
_WRIST = np.array([-BEND_M, LOWER_M])  # from the elbow of a straight arm
_LENGTHS_M = np.linalg.norm(_ELBOW), np.linalg.norm(_WRIST)
_STRAIGHT_RAD = np.arctan2(*_WRIST[::-1]) - np.arctan2(*_ELBOW[::-1])
_SIDES = np.array([1.0, -1.0])

Floats = NDArray[np.float64]


def postures(base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
    """Joints (..., BRANCHES, 7) rad for TCP poses (..., 4, 4) and the angle of the last joint (...).

    Leading axes are broadcast against one another. A branch that does not exist or leaves the limits (2, 7)
    is NaN. Neighbouring poses have the same posture in the same branch, but for `OTHER_SIGN`.
    """
    pose, last = np.asarray(base_from_tcp, dtype=float), np.asarray(last_rad, dtype=float)
    turn = np.pi / 4 - last[..., None]  # the hand is mounted 45 degrees askew
    x6 = (
        np.cos(turn) * pose[..., :3, 0] + np.sin(turn) * pose[..., :3, 1]
    )  # from the sixth axis to the seventh
    out = np.broadcast_to(pose[..., :3, 2], x6.shape)
    wrist = pose[..., :3, 3] - FLANGE_TO_TCP_M * out - WRIST_M * x6 - (0.0, 0.0, SHOULDER_M)
    reach = np.linalg.norm(wrist, axis=-1)
    found = np.full((*reach.shape, 2, 2, 2, 7), np.nan)  # bend, side, sign
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = np.arccos((reach**2 - _LENGTHS_M[0] ** 2 - _LENGTHS_M[1] ** 2) / (2 * np.prod(_LENGTHS_M)))
        for k, elbow in enumerate((-bend - _STRAIGHT_RAD, bend - _STRAIGHT_RAD)):
            if (elbow <= limits_rad[1, 3]).any():  # bent the other way it is seldom within its limits
                _fill(found[..., k, :, :, :], elbow, wrist / reach[..., None], reach, x6, out)
        found[..., 6] = last[..., None, None, None]
        inside = (found >= limits_rad[0]) & (found <= limits_rad[1])
    found[~inside.all(axis=-1)] = np.nan
    return found.reshape(*reach.shape, BRANCHES, 7)


def _fill(found: Floats, elbow: Floats, line: Floats, reach: Floats, x6: Floats, out: Floats) -> None:
    """The first six joints into (..., side, sign, 7), given the fourth (...).

    `line` (..., 3) points from the shoulder to the wrist, which are `reach` (...) m apart.
    """
    z6 = _cross(out, x6)  # the sixth axis
    cos, sin = np.cos(elbow), np.sin(elbow)
    # That line in the plane of the arm, which has one axis beside the upper arm and one along it.
    beside = (_ELBOW[0] + cos * _WRIST[0] - sin * _WRIST[1]) / reach
    along = (_ELBOW[1] + sin * _WRIST[0] + cos * _WRIST[1]) / reach
    # The fifth axis is in this plane too: its part along the line, and across.
    fifth_along, fifth_across = cos * along - sin * beside, cos * beside + sin * along
    on_line = _dot(line, z6)
    off = z6 - on_line[..., None] * line
    square = np.linalg.norm(off, axis=-1)
    first = off / square[..., None]
    cosine = -fifth_along * on_line / (fifth_across * square)  # of the plane's turn about the line
    sine = np.sqrt(1 - cosine**2)[..., None] * _SIDES
    across = (
        cosine[..., None, None] * first[..., None, :] + sine[..., None] * _cross(line, first)[..., None, :]
    )
    line, beside, along = line[..., None, :], beside[..., None, None], along[..., None, None]
    z3 = along * line + beside * across
    x3 = beside * line - along * across
    z5 = fifth_along[..., None, None] * line + fifth_across[..., None, None] * across
    x4 = cos[..., None, None] * x3 + sin[..., None, None] * z3
    x6, z6, out = x6[..., None, :], z6[..., None, :], out[..., None, :]
    found[..., 3] = elbow[..., None, None]
    found[..., 4] = np.arctan2(_dot(z6, x4), _dot(z6, _cross(x3, z3)))[..., None]
    sixth = np.arctan2(_dot(z5, x6), -_dot(z5, out))
    found[..., 5] = np.where(sixth < -np.pi / 2, sixth + 2 * np.pi, sixth)[..., None]
    z3, x3 = z3[..., None, :], x3[..., None, :]
    shoulder = np.arctan2(_SIDES * z3[..., 1], _SIDES * z3[..., 0])
    cos, sin = np.cos(shoulder), np.sin(shoulder)
    tilt = cos * z3[..., 0] + sin * z3[..., 1]
    found[..., 0] = shoulder
    found[..., 1] = np.arctan2(tilt, z3[..., 2])
    x2 = z3[..., 2] * (cos * x3[..., 0] + sin * x3[..., 1]) - tilt * x3[..., 2]
    found[..., 2] = np.arctan2(cos * x3[..., 1] - sin * x3[..., 0], x2)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.einsum("...i,...i->...", a, b)


def _cross(a: Floats, b: Floats) -> Floats:
    """np.cross of (..., 3), which takes three times as long."""
    a0, a1, a2, b0, b1, b2 = *np.moveaxis(a, -1, 0), *np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)
