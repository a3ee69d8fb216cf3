"""What fills space and how near it comes: convex pieces, the planning scene, exact clearance, occupancy.

Arms and objects are convex `Piece`s. The `PlanningScene` of a task makes `Swept` bodies of them, with allowed
contacts. `closer_than` gives the coordination diagram of two of these, `nearest` and `overlap`
their distance.
World frame, metres.
"""

from rf_exp.geometry.clearance import closer_than
from rf_exp.geometry.distance import Nearest, folded, nearest, overlap
from rf_exp.geometry.occupancy import VOXEL_M, Voxels, among, beside, centres_m, shared, voxels
from rf_exp.geometry.planning_scene import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    TABLE_MARGIN_M,
    PlanningScene,
)
from rf_exp.geometry.shapes import Piece
from rf_exp.geometry.swept import Mask, Swept
from rf_exp.geometry.table import lowest_m

__all__ = [
    "AGENT_MARGIN_M",
    "OBJECT_MARGIN_M",
    "TABLE_MARGIN_M",
    "VOXEL_M",
    "Mask",
    "Nearest",
    "Piece",
    "PlanningScene",
    "Swept",
    "Voxels",
    "among",
    "beside",
    "centres_m",
    "closer_than",
    "folded",
    "lowest_m",
    "nearest",
    "overlap",
    "shared",
    "voxels",
]
