"""A cup on a stem: a round foot, a stem that is grasped from the side, a bowl of convex wall pieces.

A gripper fits below the bowl from any side; a cube fits into the bowl.
"""

import numpy as np

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.tasks.assets.asset.rings import circle, ring
from rf_exp.transforms import from_axes, transform

FOOT_RADIUS_M, FOOT_M = 0.042, 0.010
STEM_RADIUS_M = 0.018
BOWL_M, FLOOR_M, RIM_M = 0.082, 0.104, 0.160  # heights of the bowl's underside, inner floor and rim
INNER_M, OUTER_M = 0.044, 0.049  # radii of the bowl at the corners of its wall pieces
WALLS = 16
GRIP_Z_M = 0.053  # the gripper is 1 cm above the table and 3 mm below the bowl
INSIDE_Z_M = 0.172  # release height: opening fingers stay 2 cm above the rim
AROUND = 12  # grasp directions about the stem

GLAZE, BAND = (0.55, 0.50, 0.40), (0.08, 0.22, 0.30)
BAND_M, VISUAL_OFFSET_M = 0.012, 0.0005


def build() -> Asset:
    """The cup with grasp point `stem` and drop point `inside`."""
    foot = Part.cylinder(FOOT_RADIUS_M, FOOT_M, transform((0, 0, FOOT_M / 2)), GLAZE, roughness=0.4)
    stem_m = BOWL_M - FOOT_M
    stem = Part.cylinder(STEM_RADIUS_M, stem_m, transform((0, 0, FOOT_M + stem_m / 2)), GLAZE, roughness=0.4)
    angles = np.linspace(0, 2 * np.pi, WALLS, endpoint=False)
    under = np.concatenate([circle(STEM_RADIUS_M, BOWL_M, angles), circle(OUTER_M, FLOOR_M, angles)])
    bowl = [under, *ring(INNER_M, OUTER_M, FLOOR_M, RIM_M, WALLS)]
    # Visual only: a painted band around the rim, slightly proud of the wall.
    band = ring(
        INNER_M - VISUAL_OFFSET_M, OUTER_M + VISUAL_OFFSET_M, RIM_M - BAND_M, RIM_M + VISUAL_OFFSET_M, WALLS
    )
    return Asset(
        "cup",
        parts=(
            foot,
            stem,
            *(Part.hull(piece, GLAZE, roughness=0.4) for piece in bowl),
            *(Part.hull(piece, BAND, roughness=0.4, solid=False) for piece in band),
        ),
        points={
            "stem": InteractionPoint(
                from_axes((0, 0, GRIP_Z_M), z=(0, 1, 0), y=(1, 0, 0)),
                "grasp",
                standoff_m=0.12,  # the fingers are clear of the bowl there
                width_m=2 * STEM_RADIUS_M,
                around=AROUND,
            ),
            "inside": InteractionPoint(
                transform((0, 0, INSIDE_Z_M)), "drop", standoff_m=0.10, turns=8, slack_m=0.008
            ),
        },
        mass_kg=0.25,
        friction=1.2,
    )
