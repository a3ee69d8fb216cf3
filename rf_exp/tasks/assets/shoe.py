"""A low sneaker, toe towards +x: grasped across its waist, below the high tongue.

Heel and toe are lower than the grasp, so that a gripper tilted forwards or backwards clears them.
"""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import unknown_choice
from rf_exp.tasks.assets.asset.base import Asset, Colour, InteractionPoint, Part
from rf_exp.transforms import from_axes

LENGTH_M, WIDTH_M, SOLE_M = 0.20, 0.074, 0.020
WAIST_M, WAIST_HALF_M = (-0.020, 0.040), 0.027  # along x; half width between the fingers
TOPS_M = (0.080, 0.062)  # heights of the waist at both ends
HEEL_M = 0.056  # height of the wall around the heel
GRIP_X_M, GRIP_Z_M, TIP_DEG = 0.002, 0.066, 45.0
INSOLE_M = 0.014  # above the sole
HEEL_CENTRE_M, HEEL_OUTER_M, WALL_M = -0.050, (0.044, 0.032), 0.007  # an ellipse: half axes along x, y
HEEL_WALLS = 6
VISUAL_OFFSET_M = 0.0006
BENT_M = 0.012  # inward bend of the toe, from the waist on, for one shoe of a pair

RED, DARK, WHITE, LACE = (0.60, 0.05, 0.03), (0.05, 0.03, 0.03), (0.82, 0.80, 0.76), (0.90, 0.88, 0.80)
BLUE = (0.02, 0.10, 0.45)
FEET = {"left": (-1, RED), "right": (1, BLUE)}  # foot -> (inward direction along y, colour)


def build(foot: str | None = None) -> Asset:
    """The shoe with grasp point `center`: symmetric, or one of a pair, which differ in colour.

    Raises ArgumentError for a foot that does not exist.
    """
    if foot is not None and foot not in FEET:
        raise unknown_choice("foot of a shoe", foot, FEET)
    parts = (_sole(), _insole(), *_heel(), _waist(), _tongue(), _vamp(), _cap(), *_laces(), *_stripes())
    return Asset(
        "shoe",
        parts=parts if foot is None else tuple(_for_foot(part, *FEET[foot]) for part in parts),
        points={
            "center": InteractionPoint.from_above(
                (GRIP_X_M, 0, GRIP_Z_M), width_m=2 * WAIST_HALF_M, tip_deg=TIP_DEG
            )
        },
        mass_kg=0.15,
        friction=1.2,
    )


def _for_foot(part: Part, inwards: int, colour: Colour) -> Part:
    vertices = part.mesh.vertices.copy()
    share = (vertices[:, 0] - WAIST_M[1]) / (LENGTH_M / 2 - WAIST_M[1])
    vertices[:, 1] += inwards * BENT_M * np.clip(share, 0.0, 1.0) ** 2
    bent = Part.hull(vertices, part.colour).mesh
    return replace(part, mesh=bent, colour=colour if part.colour == RED else part.colour)


def _half_width_m(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half width (K,) of the sole along its length: round at both ends, widest at the ball."""
    s = np.clip(x / (LENGTH_M / 2), -1, 1)
    round_ends = (1 - np.abs(s) ** 3.2) ** (1 / 2.2)
    return WIDTH_M / 2 * round_ends * (0.93 + 0.07 * s)


def _outline(low_x_m: float, high_x_m: float, z_m: float, inset_m: float = 0.0) -> NDArray[np.float64]:
    """Points (K, 3) of a section of the sole's outline at a height, inset by `inset_m`."""
    share = (1 - np.cos(np.linspace(0, np.pi, 16))) / 2  # closer together at the round ends
    x = low_x_m + (high_x_m - low_x_m) * share
    shrunk = x * (1 - 2 * inset_m / LENGTH_M)
    half = np.maximum(_half_width_m(x) - inset_m, 0.0)
    return np.concatenate([np.column_stack([shrunk, side * half, np.full_like(x, z_m)]) for side in (-1, 1)])


def _sole() -> Part:
    end = LENGTH_M / 2
    levels = ((0.0, 0.004), (0.005, 0.0), (SOLE_M, 0.0))
    return Part.hull(np.concatenate([_outline(-end, end, *level) for level in levels]), WHITE)


def _ellipse(angle: float, inset_m: float) -> tuple[float, float]:
    along, across = HEEL_OUTER_M
    return HEEL_CENTRE_M + (along - inset_m) * np.cos(angle), (across - inset_m) * np.sin(angle)


def _insole() -> Part:
    """The dark inside of the shoe, visible through its opening."""
    rim = [_ellipse(angle, WALL_M) for angle in np.linspace(np.pi / 2, 3 * np.pi / 2, 13)]
    floor = [(x, y) for x, y in rim] + [(WAIST_M[0], side * (HEEL_OUTER_M[1] - WALL_M)) for side in (-1, 1)]
    return Part.hull(np.array([(x, y, z) for x, y in floor for z in (SOLE_M, SOLE_M + INSOLE_M)]), DARK)


def _heel() -> list[Part]:
    """The wall around the heel in convex pieces: a half ellipse, then straight to the waist."""
    angles = np.linspace(np.pi / 2, 3 * np.pi / 2, HEEL_WALLS + 1)
    pieces = [[_ellipse(*corner) for corner in product(edge, (0.0, WALL_M))] for edge in pairwise(angles)]
    ends, across = (HEEL_CENTRE_M, WAIST_M[0] + 0.004), (HEEL_OUTER_M[1] - WALL_M, HEEL_OUTER_M[1])
    pieces += [[(x, side * y) for x, y in product(ends, across)] for side in (-1, 1)]
    corners = [np.array([(x, y, z) for (x, y), z in product(piece, (SOLE_M, HEEL_M))]) for piece in pieces]
    return [Part.hull(vertices, RED) for vertices in corners]


def _waist() -> Part:
    """The part between the fingers: upright sides, the top falling towards the toe."""
    tops = zip(WAIST_M, TOPS_M, strict=True)
    corners = [(x, side * WAIST_HALF_M, z) for x, top in tops for side in (-1, 1) for z in (SOLE_M, top)]
    return Part.hull(np.array(corners), RED)


def _tongue() -> Part:
    """A flap that stands up at the front of the opening."""
    profile = ((-0.021, 0.068), (-0.010, 0.068), (-0.015, 0.088), (-0.021, 0.088))
    half = 0.020
    return Part.hull(np.array([(x, side * half, z) for x, z in profile for side in (-1, 1)]), WHITE)


def _vamp() -> Part:
    """The upper, from the waist down to the toe."""
    start, end = WAIST_M[1] - 0.006, 0.094
    top = (start, 0.024, TOPS_M[1]), (0.080, 0.016, 0.042)
    ridge = [(x, side * half, z) for x, half, z in top for side in (-1, 1)]
    return Part.hull(np.concatenate([_outline(start, end, SOLE_M, 0.003), np.array(ridge)]), RED)


def _cap() -> Part:
    """The rubber toe cap, over the end of the vamp."""
    low, high = _outline(0.066, LENGTH_M / 2, SOLE_M, 0.001), _outline(0.068, 0.095, 0.036, 0.006)
    top = np.array([(0.066, side * 0.017, 0.047) for side in (-1, 1)])
    return Part.hull(np.concatenate([low, high, top]), WHITE)


def _laces() -> list[Part]:
    """Bars across the slope of the waist, visual only."""
    slope = (TOPS_M[1] - TOPS_M[0]) / (WAIST_M[1] - WAIST_M[0])
    bars = []
    for x in (-0.002, 0.009, 0.020, 0.031):
        z = TOPS_M[0] + slope * (x - WAIST_M[0])
        pose = from_axes((x, 0, z), z=(-slope, 0, 1), y=(0, 1, 0))
        bars.append(Part.box((0.003, 0.020, 0.0018), pose, LACE, solid=False))
    return bars


def _stripes() -> list[Part]:
    """Two slanted white stripes on either side of the waist, visual only."""
    half, ends, stripes = WAIST_HALF_M + VISUAL_OFFSET_M, ((SOLE_M + 0.002, 0.012), (0.058, 0.0)), []
    for x in (-0.014, 0.004):
        corners = product(ends, (0.0, 0.007), (-half, half))
        band = np.array([(x + shift + wide, y, z) for (z, shift), wide, y in corners])
        stripes.append(Part.hull(band, WHITE, solid=False))
    return stripes
