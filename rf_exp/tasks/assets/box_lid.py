"""The lid of the box: a plate on a rim, which lies on the walls when closed.

Its origin is the middle of the underside of the rim. Fully open it leans back, so that its weight keeps it
open.
"""

import numpy as np

from rf_exp.tasks.assets import box
from rf_exp.tasks.assets.asset.base import Asset, Hinge, InteractionPoint, Part
from rf_exp.transforms import from_axes, transform

SHUT_Z_M = box.RIM_M + box.GAP_M  # above the origin of the box
RIM_M, PLATE_M = 0.050, 0.006
OPEN_DEG, FALLS_DEG = 105.0, 63.0  # its weight keeps it open above 76 deg
FALLS_S = 1.3
DAMPING_N_M_S = 0.2
PUSH_M = 0.110  # from the hinge axis to the pushed point
TIPPED_DEG = 50.0  # tilt of the pushing gripper, more downwards than square to the plate
TIP_M = 0.0145  # from the TCP to the plate at that tilt when closed fingertips touch it

LABEL, BRASS = (0.75, 0.70, 0.60), box.BRASS


def build() -> Asset:
    """The lid with shut point `top`."""
    x, y = box.HALF_M
    top_m = RIM_M + PLATE_M
    plate = Part.box((x, y, PLATE_M / 2), transform((0, 0, top_m - PLATE_M / 2)), box.CARD)
    label = Part.box((0.05, 0.08, 0.0005), transform((-0.04, 0, top_m)), LABEL, solid=False)
    axis = box.HINGE_M[0], 0.0, box.HINGE_M[1] - SHUT_Z_M
    barrel = Part.cylinder(0.005, 0.30, from_axes(axis, z=(0, 1, 0), y=(0, 0, 1)), BRASS, solid=False)
    tipped, pushed = np.deg2rad(TIPPED_DEG), (axis[0] - PUSH_M, 0, top_m + TIP_M)
    push = from_axes(pushed, z=(np.sin(tipped), 0, -np.cos(tipped)), y=(0, 1, 0))
    return Asset(
        "box_lid",
        parts=(plate, *box.walls(0.0, RIM_M), label, barrel),
        points={"top": InteractionPoint(push, "shut", width_m=0.0)},
        hinge=Hinge(transform(axis), OPEN_DEG, FALLS_DEG, FALLS_S, DAMPING_N_M_S),
        mass_kg=0.25,
        friction=0.5,
    )
