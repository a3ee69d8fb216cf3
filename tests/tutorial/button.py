"""A red button on a grey box, fixed to the table."""

from rf_exp.tasks.assets import Asset, InteractionPoint, Part
from rf_exp.transforms import from_axes, transform

BOX_HALF_M = (0.05, 0.05, 0.02)
CAP_RADIUS_M, CAP_M = 0.025, 0.015
PRESS_M = -0.001  # the finger tips are sent this far into the cap, so that they push
GREY, RED = (0.25, 0.26, 0.28), (0.65, 0.03, 0.03)


def build() -> Asset:
    """The button with press point `cap`. Origin on the table, in the middle of the box."""
    top_m = 2 * BOX_HALF_M[2]
    return Asset(
        "button",
        parts=(
            Part.box(BOX_HALF_M, transform((0, 0, BOX_HALF_M[2])), GREY),
            Part.cylinder(CAP_RADIUS_M, CAP_M, transform((0, 0, top_m + CAP_M / 2)), RED),
        ),
        points={
            "cap": InteractionPoint(
                from_axes((0, 0, top_m + CAP_M + PRESS_M), z=(0, 0, -1), y=(0, 1, 0)), "press", turns=8
            )
        },
        static=True,
    )
