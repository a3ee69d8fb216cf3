"""The lid of the pot, a separate body: a disc, a plug that centres it in the rim, and a knob.

Its origin is the underside of the plug, so it lies on the table at z = 0 and on the pot at
z = SEAT_Z_M above the pot's origin.
"""

import numpy as np

from rf_exp.tasks.assets import pot
from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.tasks.assets.asset.rings import circle
from rf_exp.transforms import transform

PLUG_M = pot.PLUG_M
PLUG_TOP_M, PLUG_BOTTOM_M = 0.079, 0.074  # radii; the taper guides the lid back in
SEAT_Z_M = pot.HEIGHT_M - PLUG_M
DISC_M = 0.007
KNOB_M, KNOB_HEIGHT_M = 0.030, 0.036  # width between the fingers; height above the disc
GRIP_Z_M = PLUG_M + DISC_M + 0.022  # fingertips end 12 mm above the disc, the palm clears the knob

STEEL, BLACK = (0.42, 0.45, 0.50), (0.03, 0.03, 0.035)


def build() -> Asset:
    """The lid with grasp point `knob`."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    # The plug ends inside the disc: with plug and rim edges at one height, PhysX reports contacts 10 cm deep.
    plug_top_m = PLUG_M + DISC_M / 2
    plug = np.concatenate([circle(PLUG_BOTTOM_M, 0.0, angles), circle(PLUG_TOP_M, plug_top_m, angles)])
    top = PLUG_M + DISC_M
    disc = np.concatenate([circle(pot.OUTER_M, PLUG_M, angles), circle(pot.OUTER_M - 0.004, top, angles)])
    half = KNOB_M / 2
    knob = Part.box((half, half, KNOB_HEIGHT_M / 2), transform((0, 0, top + KNOB_HEIGHT_M / 2)), BLACK)
    return Asset(
        "lid",
        parts=(
            Part.hull(plug, STEEL, roughness=0.3, metallic=0.3),
            Part.hull(disc, STEEL, roughness=0.3, metallic=0.3),
            knob,
        ),
        points={"knob": InteractionPoint.from_above((0, 0, GRIP_Z_M), width_m=KNOB_M)},
        mass_kg=0.08,
        friction=1.2,
    )
