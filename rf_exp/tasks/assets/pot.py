"""An open stewing pot: a ring of convex wall pieces on a floor, two small handles along x."""

from dataclasses import replace

from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.tasks.assets.asset.rings import ring
from rf_exp.transforms import transform

INNER_M, OUTER_M = 0.085, 0.100  # radii at the corners of the wall pieces
HEIGHT_M, FLOOR_M = 0.096, 0.010
WALLS = 16
PLUG_M = 0.008  # depth of the lid's plug inside the pot
INSIDE_Z_M = 0.052  # release height: the gripper stays above the rim, the food falls 4 cm

ENAMEL, RIM, IRON = (0.10, 0.24, 0.42), (0.55, 0.58, 0.62), (0.05, 0.05, 0.06)
RIM_HEIGHT_M, VISUAL_OFFSET_M = 0.006, 0.0005
# Two objects side by side: offset from the middle, and release height with the gripper above the rim.
SPOT_M, OVER_M = 0.042, 0.088


def build(spots: int = 1, closes: bool = False) -> Asset:
    """The pot with drop point `inside`, or `inside1` and `inside2` for two objects side by side.

    With `closes`, a place point `rim` for its lid. Raises ArgumentError for more than two spots.
    """
    if spots not in (1, 2):
        raise ArgumentError(f"spots is {spots!r}; a pot holds one thing, or two side by side")
    floor = Part.cylinder(INNER_M, FLOOR_M, transform((0, 0, FLOOR_M / 2)), ENAMEL, roughness=0.3)
    walls = [
        Part.hull(piece, ENAMEL, roughness=0.3) for piece in ring(INNER_M, OUTER_M, 0.0, HEIGHT_M, WALLS)
    ]
    handles = [
        Part.box((0.017, 0.028, 0.006), transform((side * (OUTER_M + 0.014), 0, 0.07)), IRON)
        for side in (-1, 1)
    ]
    # Visual only: a bright rim, slightly proud of the wall.
    band = ring(
        INNER_M - VISUAL_OFFSET_M,
        OUTER_M + VISUAL_OFFSET_M,
        HEIGHT_M - RIM_HEIGHT_M,
        HEIGHT_M + VISUAL_OFFSET_M,
        WALLS,
    )
    rim = [Part.hull(piece, RIM, roughness=0.3, metallic=0.3, solid=False) for piece in band]
    inside = InteractionPoint(transform((0, 0, INSIDE_Z_M)), "drop", standoff_m=0.10, turns=8, slack_m=0.03)
    points = {"inside": inside}
    if spots > 1:
        points = {
            f"inside{k}": replace(inside, object_from_tcp=transform((0, side * SPOT_M, OVER_M)), slack_m=0.0)
            for k, side in ((1, -1), (2, 1))
        }
    if closes:
        points["rim"] = InteractionPoint(transform((0, 0, HEIGHT_M - PLUG_M)), "place", turns=8)
    return Asset("pot", parts=(floor, *walls, *handles, *rim), points=points, mass_kg=0.8, friction=1.2)
