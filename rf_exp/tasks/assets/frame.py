"""A frame that several arms lift: a ring of bars on the table, grasped from above at equal angles."""

import numpy as np

from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import Matrix, from_axes, planar, transform

MOST_GRIPS = 8
RADIUS_M = 0.25  # least radius, to the middle of the bars
APART_M = 0.3  # least distance of two grasps: a gripper is 0.2 m wide, and arms come from outside
THICKNESS_M, HEIGHT_M = 0.026, 0.06  # of a bar, well below the gripper's opening of 0.08 m
GRIP_Z_M = 0.042  # fingertips clear the table, the palm clears the bar
BARS = 24  # even, for alternating colours
YELLOW, BLACK = (0.75, 0.45, 0.02), (0.03, 0.03, 0.035)


def build(grips: int = 2) -> Asset:
    """The frame with grasp points `grip1` .. `grip<n>`; a single one is in the middle of a bar across.

    The first is at -90 degrees, as is the first arm of a circle. Raises ArgumentError for a number of grips
    out of bounds.
    """
    if not 1 <= grips <= MOST_GRIPS:
        raise ArgumentError(f"grips={grips} of a frame; expected 1 to {MOST_GRIPS}")
    radius_m = RADIUS_M if grips == 1 else max(RADIUS_M, APART_M / (2 * np.sin(np.pi / grips)))
    half_m = radius_m * np.tan(np.pi / BARS)
    bars = [_bar(radius_m, 2 * np.pi * k / BARS, half_m, (YELLOW, BLACK)[k % 2]) for k in range(BARS)]
    if grips == 1:
        bars.append(_bar(0.0, 0.0, radius_m - THICKNESS_M / 2, YELLOW))
    angles = [2 * np.pi * k / grips - np.pi / 2 for k in range(grips)]
    points = {f"grip{k}": _grip(radius_m * (grips > 1), angle) for k, angle in enumerate(angles, start=1)}
    return Asset("frame", parts=tuple(bars), points=points, mass_kg=0.3, friction=1.2)


def _bar(radius_m: float, angle_rad: float, half_m: float, colour: tuple[float, float, float]) -> Part:
    """A bar along the circle, at an angle."""
    out: Matrix = planar(0.0, 0.0, angle_rad) @ transform((radius_m, 0.0, HEIGHT_M / 2))
    return Part.box((THICKNESS_M / 2, half_m, HEIGHT_M / 2), out, colour)


def _grip(radius_m: float, angle_rad: float) -> InteractionPoint:
    """A grasp of a bar from above; the fingers close on its long faces."""
    out = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    bar = out if radius_m else np.array([1.0, 0.0, 0.0])  # the bar across lies along y
    at = radius_m * out + (0.0, 0.0, GRIP_Z_M)
    return InteractionPoint(from_axes(at, z=(0, 0, -1), y=bar), "grasp", width_m=THICKNESS_M)
