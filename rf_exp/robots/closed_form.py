"""Closed-form inverse kinematics of the Panda and of the xArm7: all postures that put the TCP at a pose.

Both have a joint to spare, and are alike but for lengths and for how joints are counted. With the last joint
given, what is left is geometry: the wrist follows from the pose, the bend of the elbow from the distance
between wrist and shoulder, and the elbow lies on a circle about the line between them, at the two places
where the fifth axis is square to the sixth (He and Liu 2021, "Analytical inverse kinematics for Franka Emika
Panda"). Frames are those of Franka's control interface documentation (Craig's convention).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.transforms import wrapped_rad

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

BRANCHES = 8  # bend of the elbow x its place on the circle x sign of the second joint
OTHER_SIGN = np.arange(BRANCHES) ^ 1  # the branch beyond an upright shoulder, where an arm crosses over

_SIDES = np.array([1.0, -1.0])
NEAR_RAD, STEP_RAD = 0.3, 0.02  # from the last joint of a tool that points down: at most, and first
SECANTS, CLOSE = 3, 1e-6  # steps, and how near to zero they have to come

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Lengths:
    """Of an arm whose elbow's axis lies beside the upper arm, and beside the lower one, in m."""

    shoulder_m: float  # its height above the base
    upper_m: float
    lower_m: float
    before_m: float  # the elbow's axis beside the upper arm
    behind_m: float  # and beside the lower one
    wrist_m: float  # between the sixth and the seventh axis
    flange_to_tcp_m: float  # along the seventh axis, from where the wrist is square to it to the TCP

    @cached_property
    def elbow(self) -> Floats:
        """(2,) from the shoulder: beside the upper arm, along it."""
        return np.array([self.before_m, self.upper_m])

    @cached_property
    def wrist(self) -> Floats:
        """(2,) from the elbow of a straight arm."""
        return np.array([-self.behind_m, self.lower_m])

    @cached_property
    def ends_m(self) -> tuple[np.floating, np.floating]:
        """From the elbow's axis to shoulder and wrist."""
        return np.linalg.norm(self.elbow), np.linalg.norm(self.wrist)

    @cached_property
    def straight_rad(self) -> float:
        return np.arctan2(*self.wrist[::-1]) - np.arctan2(*self.elbow[::-1])


PANDA = Lengths(0.333, 0.316, 0.384, 0.0825, 0.0825, 0.088, 0.2104)  # of Franka's documentation
XARM7 = Lengths(0.267, 0.293, 0.3425, 0.0525, 0.0775, 0.076, 0.2004)  # of its URDF, with the Panda's hand


def postures(
    base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats, lengths: Lengths = PANDA
) -> Floats:
    """Joints (..., BRANCHES, 7) rad for TCP poses (..., 4, 4) and the angle of the last joint (...).

    Leading axes are broadcast against one another. A branch that does not exist or leaves the limits (2, 7)
    is NaN. Neighbouring poses have the same posture in the same branch, but for `OTHER_SIGN`.
    """
    pose, last = np.asarray(base_from_tcp, dtype=float), np.asarray(last_rad, dtype=float)
    # Vectors are (3, ...) here: NumPy is several times as fast along long rows as along three components.
    pose = np.broadcast_to(pose, (*np.broadcast_shapes(pose.shape[:-2], last.shape), 4, 4))
    x, y, out, position = np.ascontiguousarray(np.moveaxis(pose[..., :3, :], (-1, -2), (0, 1)))
    x6, wrist = _wrist(lengths, x, y, out, position, last)
    reach = _length(wrist)
    found = np.full((7, *reach.shape, 2, 2, 2), np.nan)  # bend, side, sign
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = _bend(lengths, reach)
        for k, elbow in enumerate((-bend - lengths.straight_rad, bend - lengths.straight_rad)):
            if (elbow <= limits_rad[1, 3]).any():  # bent the other way it is seldom within its limits
                _fill(lengths, found[..., k, :, :], elbow, wrist / reach, reach, x6, out)
        found[6] = last[..., None, None, None]
        low, high = (limits.reshape(-1, *[1] * (found.ndim - 1)) for limits in limits_rad)
        inside = ((found >= low) & (found <= high)).all(axis=0)
    found[:, ~inside] = np.nan
    return np.moveaxis(found.reshape(7, *reach.shape, BRANCHES), 0, -1)


class ClosedForm:
    """The Panda's `rf_exp.robots.Inverse`."""

    branches, other, lengths = BRANCHES, OTHER_SIGN, PANDA

    def __init__(self, _: "Robot") -> None: ...

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        return postures(base_from_tcp, last_rad, limits_rad, self.lengths)

    def facing(self, base_from_tcp: Floats) -> Floats:
        """See `Inverse`: the angle that puts the arm into an upright plane, in which the third joint is zero.

        Where the upper arm stands almost straight up, the first joint and the third turn about nearly one
        axis, and such a posture is the only one of many that an arm reaches soon. Where there is none within
        NEAR_RAD of the angle with which it would be if the tool pointed straight down, that angle.
        """
        pose = base_from_tcp
        away = pose[..., :2, 3] / np.linalg.norm(pose[..., :2, 3], axis=-1, keepdims=True)
        ahead = np.einsum("...i,...ij->...j", away, pose[..., :2, :2])
        near = np.pi / 4 - np.arctan2(ahead[..., 1], ahead[..., 0])
        x, y, out, position = np.ascontiguousarray(np.moveaxis(pose[..., :3, :], (-1, -2), (0, 1)))
        before, last = near, near + STEP_RAD
        with np.errstate(invalid="ignore", divide="ignore"):
            was, found = (_out_of_plane(self.lengths, x, y, out, position, each) for each in (before, last))
            for _ in range(SECANTS):
                change = np.nan_to_num(found * (last - before) / (found - was))
                before, was, last = last, found, last - change
                found = _out_of_plane(self.lengths, x, y, out, position, last)
            good = (np.abs(found) < CLOSE) & (np.abs(last - near) < NEAR_RAD)
        return wrapped_rad(np.where(good, last, near))


class XArm7ClosedForm(ClosedForm):
    """The xArm7's: its fourth joint is zero where the Panda's is at -180 degrees, its sixth backwards."""

    lengths = XARM7

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        low, high = limits = limits_rad.copy()
        limits[:, 3] -= np.pi
        low[5], high[5] = np.pi - high[5], np.pi - low[5]
        found = super().postures(base_from_tcp, last_rad, limits)
        found[..., 3] += np.pi
        found[..., 5] = np.pi - found[..., 5]
        return found


def _out_of_plane(
    lengths: Lengths, x: Floats, y: Floats, out: Floats, position: Floats, last: Floats
) -> Floats:
    """(...) zero where an arm can be in an upright plane: its fifth axis on the sixth, which are square."""
    x6, wrist = _wrist(lengths, x, y, out, position, last)
    reach = _length(wrist)
    elbow = -_bend(lengths, reach) - lengths.straight_rad
    beside, _, fifth_along, fifth_across = _plane(lengths, np.cos(elbow), np.sin(elbow), reach)
    line = wrist / reach
    up = -line[2] * line
    up[2] += 1
    across = np.where(beside < 0, -1.0, 1.0) * up / _length(up)  # the elbow is above the line
    return _dot(fifth_along * line + fifth_across * across, _cross(out, x6))


def _wrist(
    lengths: Lengths, x: Floats, y: Floats, out: Floats, position: Floats, last: Floats
) -> tuple[Floats, Floats]:
    """From the sixth axis to the seventh, and from the shoulder to the wrist in m: both (3, ...)."""
    turn = np.pi / 4 - last  # the hand is mounted 45 degrees askew
    x6 = np.cos(turn) * x + np.sin(turn) * y
    wrist = position - lengths.flange_to_tcp_m * out - lengths.wrist_m * x6
    wrist[2] -= lengths.shoulder_m
    return x6, wrist


def _bend(lengths: Lengths, reach: Floats) -> Floats:
    """(...) rad of the elbow, from how far it is from the shoulder to the wrist."""
    upper_m, lower_m = lengths.ends_m
    return np.arccos((reach**2 - upper_m**2 - lower_m**2) / (2 * (upper_m * lower_m)))


def _plane(
    lengths: Lengths, cos: Floats, sin: Floats, reach: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """In the plane of an arm whose elbow is bent so: the line from shoulder to wrist, beside the upper arm
    and along it; the fifth axis, along that line and across it.
    """
    elbow, wrist = lengths.elbow, lengths.wrist
    beside = (elbow[0] + cos * wrist[0] - sin * wrist[1]) / reach
    along = (elbow[1] + sin * wrist[0] + cos * wrist[1]) / reach
    return beside, along, cos * along - sin * beside, cos * beside + sin * along


def _fill(
    lengths: Lengths, found: Floats, elbow: Floats, line: Floats, reach: Floats, x6: Floats, out: Floats
) -> None:
    """The first six joints into (7, ..., side, sign), given the fourth (...).

    `line` (3, ...) points from the shoulder to the wrist, which are `reach` (...) m apart.
    """
    z6 = _cross(out, x6)  # the sixth axis
    cos, sin = np.cos(elbow), np.sin(elbow)
    beside, along, fifth_along, fifth_across = _plane(lengths, cos, sin, reach)
    on_line = _dot(line, z6)
    off = z6 - on_line * line
    square = _length(off)
    first = off / square
    cosine = -fifth_along * on_line / (fifth_across * square)  # of the plane's turn about the line
    sine = np.sqrt(1 - cosine**2)[..., None] * _SIDES
    across = cosine[..., None] * first[..., None] + sine * _cross(line, first)[..., None]  # (3, ..., side)
    line, beside, along = line[..., None], beside[..., None], along[..., None]
    z3 = along * line + beside * across
    x3 = beside * line - along * across
    z5 = fifth_along[..., None] * line + fifth_across[..., None] * across
    x4 = cos[..., None] * x3 + sin[..., None] * z3
    x6, z6, out = x6[..., None], z6[..., None], out[..., None]
    found[3] = elbow[..., None, None]
    found[4] = np.arctan2(_dot(z6, x4), _dot(z6, _cross(x3, z3)))[..., None]
    along_out = z5[0] * out[0] + z5[1] * out[1] + z5[2] * out[2]
    sixth = np.arctan2(_dot(z5, x6), -along_out)
    found[5] = np.where(sixth < -np.pi / 2, sixth + 2 * np.pi, sixth)[..., None]
    z3, x3 = z3[..., None], x3[..., None]  # (3, ..., side, sign)
    shoulder = np.arctan2(_SIDES * z3[1], _SIDES * z3[0])
    cos, sin = np.cos(shoulder), np.sin(shoulder)
    tilt = cos * z3[0] + sin * z3[1]
    found[0] = shoulder
    found[1] = np.arctan2(tilt, z3[2])
    x2 = z3[2] * (cos * x3[0] + sin * x3[1]) - tilt * x3[2]
    found[2] = np.arctan2(cos * x3[1] - sin * x3[0], x2)


def _dot(a: Floats, b: Floats) -> Floats:
    """(...) of vectors (3, ...). Bytes of episodes hang on the order in which it adds."""
    return (a[0] * b[0] + a[2] * b[2]) + a[1] * b[1]


def _length(a: Floats) -> Floats:
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
