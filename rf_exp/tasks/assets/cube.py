"""A toy building block with dark edges, which make its yaw visible."""

import numpy as np

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

COLOURS = {"blue": (0.02, 0.12, 0.62), "red": (0.62, 0.02, 0.02), "green": (0.02, 0.38, 0.06)}
EDGES = {"blue": (0.005, 0.02, 0.12), "red": (0.12, 0.005, 0.005), "green": (0.005, 0.07, 0.015)}
SMALLEST_M, LARGEST_M = 0.014, 0.028  # half sides: fingers clear the table, and the palm the top
TIP_DEG = 30.0  # largest tilt at which the fingers clear the table
GRIP_HEIGHT = 0.9  # grasp height, as a fraction of the half side
EDGE_WIDTH, VISUAL_OFFSET_M = 0.1, 0.0003  # width of a painted edge as a fraction of the half side


def build(colour: str = "blue", half_m: float = 0.02) -> Asset:
    """The cube with grasp point `center` and place point `top`.

    Raises ArgumentError for a colour that does not exist and for a size that the gripper does not fit.
    """
    if colour not in COLOURS:
        raise unknown_choice("colour of a cube", colour, COLOURS)
    if not SMALLEST_M <= half_m <= LARGEST_M:
        raise ArgumentError(f"half_m={half_m} of a cube; expected {SMALLEST_M} to {LARGEST_M} m")
    middle = transform((0, 0, half_m))
    # Paint on two opposite faces each, inset from the edges of the dark block.
    faces = [
        Part.box(
            np.where(np.arange(3) == axis, half_m + VISUAL_OFFSET_M, (1 - EDGE_WIDTH) * half_m)
            - _paint_offset(axis),
            middle @ transform(_paint_offset(2) if axis == 2 else (0, 0, 0)),
            COLOURS[colour],
            solid=False,
        )
        for axis in range(3)
    ]
    return Asset(
        "cube",
        parts=(Part.box((half_m,) * 3, middle, EDGES[colour]), *faces),
        points={
            "center": InteractionPoint.from_above(
                (0, 0, GRIP_HEIGHT * half_m), width_m=2 * half_m, tip_deg=TIP_DEG, turns=4
            ),
            "top": InteractionPoint(transform((0, 0, 2 * half_m)), "place", turns=4),
        },
        mass_kg=0.055,
        friction=1.0,
    )


def _paint_offset(axis: int) -> np.ndarray:
    """Half the paint's thickness upwards: the underside is not painted."""
    return np.array([0, 0, VISUAL_OFFSET_M / 2]) if axis == 2 else np.zeros(3)
