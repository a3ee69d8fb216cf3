"""A target painted on the table: rings that thicken towards the middle, to avoid z-fighting."""

from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

CREAM, SLATE = (0.62, 0.60, 0.54), (0.16, 0.19, 0.24)
RINGS = ((1.0, SLATE), (0.9, CREAM), (0.62, SLATE), (0.54, CREAM), (0.12, SLATE))  # (part of radius, colour)
FIRST_M, STEP_M = 0.0003, 0.00012  # thickness of the widest ring, and increase per ring


def build(radius_m: float = 0.1) -> Asset:
    """The target with place point `middle`; rendered, without collision."""
    if radius_m <= 0:
        raise ArgumentError(f"radius_m={radius_m} of a goal; expected more than 0 m")
    rings = []
    for k, (share, colour) in enumerate(RINGS):
        thick_m = FIRST_M + k * STEP_M
        rings.append(Part.cylinder(share * radius_m, thick_m, transform((0, 0, thick_m / 2)), colour))
    return Asset(
        "goal",
        parts=tuple(rings),
        points={"middle": InteractionPoint(transform(), "place", turns=12)},
        visual_only=True,
    )
