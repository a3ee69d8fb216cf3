"""A box for a pair of shoes, fixed to the table, open at the top; `box_lid` is hinged to its +x wall."""

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

HALF_M = (0.160, 0.152)  # outside, along x and y
WALL_M, FLOOR_M = 0.008, 0.006
RIM_M = 0.085  # height of the walls, below the palm of a gripper that holds a shoe on the floor
GAP_M = 0.001  # between rim and lid
HINGE_M = (0.164, RIM_M + 0.006)  # x and z of the hinge axis
SIDE_M = (-0.020, 0.066)  # x and y of the middle of the shoe on the +y side; y is mirrored for the other
INSIDE_Z_M = FLOOR_M + 0.006  # release height, so that a held shoe clears the floor
SLACK_M = 0.015

CARD, INSIDE, BRASS = (0.32, 0.20, 0.11), (0.50, 0.40, 0.28), (0.55, 0.42, 0.15)


def build() -> Asset:
    """The box with drop points `left` (y < 0) and `right`."""
    x, y = HALF_M
    floor = Part.box((x, y, FLOOR_M / 2), transform((0, 0, FLOOR_M / 2)), INSIDE)
    # Visual only: bearings of the hinge.
    knuckles = [
        Part.box((0.004, 0.02, 0.008), transform((x + 0.002, side * 0.10, RIM_M - 0.010)), BRASS, solid=False)
        for side in (-1, 1)
    ]
    points = {
        name: InteractionPoint(
            transform((SIDE_M[0], side * SIDE_M[1], INSIDE_Z_M)), "drop", turns=2, slack_m=SLACK_M
        )
        for name, side in (("left", -1), ("right", 1))
    }
    return Asset("box", parts=(floor, *walls(FLOOR_M, RIM_M), *knuckles), points=points, static=True)


def walls(low_m: float, high_m: float) -> list[Part]:
    """The four walls between two heights, of the box or its lid."""
    x, y = HALF_M
    half, up_m, middle_m = WALL_M / 2, (high_m - low_m) / 2, low_m + (high_m - low_m) / 2
    sides = (((half, y, up_m), (x - half, 0.0)), ((x - WALL_M, half, up_m), (0.0, y - half)))
    return [
        Part.box(size, transform((side * at[0], side * at[1], middle_m)), CARD)
        for size, at in sides
        for side in (-1, 1)
    ]
