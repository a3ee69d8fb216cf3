"""Time parameterisation: joint targets on the control grid, within velocity and acceleration limits."""

import logging
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from rf_exp.datagen.motion.state import Floats
from rf_exp.errors import StageError
from rf_exp.types import CONTROL_DT_S, JointLimits

if TYPE_CHECKING:
    from toppra.constraint import Constraint

logging.getLogger("toppra").setLevel(logging.ERROR)

CORNER_RAD = 0.1  # radius of an arc that can be passed as fast as a corner rounded by `blend`
SPACING_RAD = 0.01  # of path points, largest joint; fine compared with every blended corner
LEAST_RAD = 1e-7  # shorter paths take one control step, which is ample; TOPP-RA fails along 1e-9 to 1e-8


def densify(via: Floats) -> Floats:
    """Points (M, D) about SPACING_RAD apart along the polyline of via points (K, D)."""
    gaps = np.abs(np.diff(via, axis=0)).max(axis=1)
    via = via[np.concatenate([[True], gaps > 1e-9])]
    if len(via) < 2:
        return via
    s = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(via, axis=0)).max(axis=1))])
    grid = np.linspace(0.0, s[-1], max(2, int(np.ceil(s[-1] / SPACING_RAD)) + 1))
    return np.column_stack([np.interp(grid, s, joint) for joint in via.T])


def blend(points: Floats, radius_rad: float) -> Floats:
    """Dense points (M, D) with corners rounded over +- radius; both ends stay exactly where they are.

    A motion that need not stop at a corner is much shorter in time than two that do. The moving
    average shrinks towards the ends, so a straight end stays straight.
    """
    half = min(int(radius_rad / SPACING_RAD), (len(points) - 1) // 2)
    if half < 1:
        return points
    # Two passes, so that the rounding has no edge of its own. Padding by reflection through the end
    # points makes averages of a straight end exact.
    pad = half + half // 2
    head = 2 * points[0] - points[pad:0:-1]
    tail = 2 * points[-1] - points[-2 : -pad - 2 : -1]
    smooth = np.concatenate([head, points, tail])
    for window in (half, half // 2):
        smooth = uniform_filter1d(smooth, 2 * window + 1, axis=0, mode="nearest")
    smooth = smooth[pad:-pad]
    smooth[0], smooth[-1] = points[0], points[-1]
    return smooth


def duration_s(corners: Floats, limits: JointLimits) -> Floats:
    """(...) s, estimate for `parameterise` of rest-to-rest motions round corners (..., K, D) rad.

    Legs are straight, corners rounded by `blend`: each corner bounds the speed, between them acceleration
    does. Four in five estimates for approaches between random postures are right within 0.2 s, without bias.
    Infinite where a corner is NaN.
    """
    moves = np.diff(corners, axis=-2)
    lengths = np.abs(moves).max(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        directions = np.where(lengths[..., None] > 0, moves / lengths[..., None], 0.0)
        turns = np.abs(np.diff(directions, axis=-2)).max(axis=-1)
        fastest = np.sqrt(limits.acceleration_rad_s2 * CORNER_RAD / turns)
    speeds = np.zeros((*lengths.shape[:-1], lengths.shape[-1] + 1))  # at the corners
    speeds[..., 1:-1] = np.minimum(fastest, limits.velocity_rad_s)
    gains = 2 * limits.acceleration_rad_s2 * lengths  # bound on the change of a squared speed
    for k in range(lengths.shape[-1]):
        speeds[..., k + 1] = np.minimum(speeds[..., k + 1], np.sqrt(speeds[..., k] ** 2 + gains[..., k]))
    for k in reversed(range(lengths.shape[-1])):
        speeds[..., k] = np.minimum(speeds[..., k], np.sqrt(speeds[..., k + 1] ** 2 + gains[..., k]))
    squares = speeds[..., :-1] ** 2 + speeds[..., 1:] ** 2
    peaks = np.minimum(limits.velocity_rad_s, np.sqrt((gains + squares) / 2))
    ramps_s = (2 * peaks - speeds[..., :-1] - speeds[..., 1:]) / limits.acceleration_rad_s2
    ramps_rad = (2 * peaks**2 - squares) / (2 * limits.acceleration_rad_s2)
    with np.errstate(invalid="ignore", divide="ignore"):
        legs_s = ramps_s + np.where(peaks > 0, (lengths - ramps_rad) / peaks, 0.0)
    total_s = legs_s.sum(axis=-1)
    return np.where(np.isnan(total_s), np.inf, total_s)


def parameterise(points: Floats, limits: JointLimits) -> Floats:
    """Fastest rest-to-rest motion along points (M, D) rad, sampled at the control rate: (T, D).

    The first sample is one control step after the start, the last lies exactly on the end. The
    duration is rounded up to whole control steps. Uses TOPP-RA (Pham and Pham 2018, `toppra`).
    Raises StageError when no parameterisation exists.
    """
    # Imported here as it imports Matplotlib, and not every user of this module times paths.
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA

    points = densify(points)
    if len(points) < 2:
        return np.empty((0, points.shape[1]))
    s = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(points, axis=0)).max(axis=1))])
    if s[-1] < LEAST_RAD:
        return points[-1:]
    path = SplineInterpolator(s, points)
    problem = TOPPRA(
        _within(limits, points.shape[1]),
        path,
        gridpoints=np.linspace(0.0, s[-1], int(np.clip(len(points), 101, 301))),
        parametrizer="ParametrizeConstAccel",
        solver_wrapper="seidel",
    )
    motion: Any = problem.compute_trajectory(0.0, 0.0)  # typed too widely by toppra
    if motion is None:
        raise StageError(
            f"no time parameterisation within {limits} exists for a path of {len(points)} points"
        )
    steps = int(np.ceil(motion.duration / CONTROL_DT_S - 1e-6))
    while True:
        timed = motion(np.arange(1, steps + 1) * (motion.duration / steps))
        excess = _excess(points[0], timed, limits)
        if excess <= 1.0 + 1e-3:
            return timed
        # TOPP-RA keeps the limits on its own grid; where the samples exceed them, the motion is slowed down.
        steps = max(steps + 1, int(np.ceil(steps * excess)))


@cache
def _within(limits: JointLimits, dimensions: int) -> "list[Constraint]":
    """toppra's constraints for the limits of so many joints; cached, as it takes long to check them."""
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    bound = np.ones((dimensions, 1)) * np.array([[-1.0, 1.0]])
    return [
        JointVelocityConstraint(limits.velocity_rad_s * bound),
        JointAccelerationConstraint(limits.acceleration_rad_s2 * bound),
    ]


def _excess(start: Floats, timed: Floats, limits: JointLimits) -> float:
    """The factor by which the samples (T, D) have to be slowed down to keep the limits."""
    positions = np.concatenate([start[None], start[None], timed, timed[-1:]])
    velocity = np.diff(positions, axis=0) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_DT_S
    return max(
        float(np.abs(velocity).max()) / limits.velocity_rad_s,
        float(np.sqrt(np.abs(acceleration).max() / limits.acceleration_rad_s2)),
    )
