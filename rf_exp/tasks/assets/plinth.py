"""A stone block that carries another object, fixed to the table."""

from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

STONE, PALE = (0.30, 0.30, 0.29), (0.50, 0.50, 0.47)
BAND, VISUAL_OFFSET_M = 0.16, 0.001  # height of the pale bands as a fraction; visual only


def build(half_m: float = 0.06) -> Asset:
    """A cube of half side `half_m` with place point `top`."""
    if half_m <= 0:
        raise ArgumentError(f"half_m={half_m} of a plinth; expected more than 0 m")
    height_m = 2 * half_m
    thick_m = BAND * height_m / 2
    bands = [
        Part.box(
            (half_m + VISUAL_OFFSET_M, half_m + VISUAL_OFFSET_M, thick_m),
            transform((0, 0, z)),
            PALE,
            solid=False,
        )
        for z in (thick_m, height_m - VISUAL_OFFSET_M - thick_m)  # the top stays flat
    ]
    return Asset(
        "plinth",
        parts=(Part.box((half_m,) * 3, transform((0, 0, half_m)), STONE, roughness=0.9), *bands),
        points={"top": InteractionPoint(transform((0, 0, height_m)), "place")},
        mass_kg=2.0,
        static=True,
    )
