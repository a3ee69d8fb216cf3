"""A striped road barrier: a long board on two feet, gripped near both ends (length along x)."""

import numpy as np

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

LENGTH_M = 0.60
THICKNESS_M = 0.026  # along y, well below the gripper's opening of 0.08 m
BOTTOM_M, TOP_M = 0.046, 0.096  # of the board
GRIP_X_M, GRIP_Z_M = 0.222, 0.074
FOOT_X_M, FOOT_LENGTH_M, FOOT_HEIGHT_M = 0.13, 0.16, 0.016
HEAVIEST_KG = 9.5  # of steel; two grippers that lift together lose 10.5 kg
STRIPES, SLANT_M, VISUAL_OFFSET_M = 5, 0.03, 0.0005  # stripes stand proud of the board to avoid z-fighting

WHITE, RED, STEEL = (0.85, 0.84, 0.80), (0.72, 0.04, 0.03), (0.10, 0.11, 0.13)


def build() -> Asset:
    """The barrier with grasp points `left` (x < 0) and `right` (x > 0)."""
    half = (LENGTH_M / 2, THICKNESS_M / 2, (TOP_M - BOTTOM_M) / 2)
    board = Part.box(half, transform((0, 0, (TOP_M + BOTTOM_M) / 2)), WHITE)
    feet = [part for side in (-1, 1) for part in _foot(side * FOOT_X_M)]
    pitch = LENGTH_M / STRIPES
    stripes = [_stripe((i + 0.5) * pitch - LENGTH_M / 2, pitch / 4) for i in range(STRIPES)]
    return Asset(
        "barrier",
        parts=(board, *feet, *stripes),
        points={  # the fingers close on the two faces of the board
            side: InteractionPoint.from_above((x_m, 0, GRIP_Z_M), width_m=THICKNESS_M)
            for side, x_m in (("left", -GRIP_X_M), ("right", GRIP_X_M))
        },
        mass_kg=0.1,
        heaviest_kg=HEAVIEST_KG,
        friction=1.2,
    )


def _foot(x_m: float) -> tuple[Part, Part]:
    """A post under the board and a beam across it that keeps the board from tipping over."""
    low = FOOT_HEIGHT_M / 2
    beam = Part.box((0.02, FOOT_LENGTH_M / 2, low), transform((x_m, 0, low)), STEEL)
    half = (BOTTOM_M - FOOT_HEIGHT_M) / 2
    post = Part.box((0.012, 0.01, half), transform((x_m, 0, FOOT_HEIGHT_M + half)), STEEL)
    return beam, post


def _stripe(x_m: float, half_width_m: float) -> Part:
    """A slanted red band around the board, without collision: the board stays flat for the fingers."""
    corners = [
        (x_m + side * half_width_m + slant, y, z)
        for side in (-1, 1)
        for z, slant in ((BOTTOM_M - VISUAL_OFFSET_M, -SLANT_M / 2), (TOP_M + VISUAL_OFFSET_M, SLANT_M / 2))
        for y in (-THICKNESS_M / 2 - VISUAL_OFFSET_M, THICKNESS_M / 2 + VISUAL_OFFSET_M)
    ]
    return Part.hull(np.array(corners), RED, solid=False)
