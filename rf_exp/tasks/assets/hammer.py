"""A mallet that lies with the axis of its head vertical: the striking face points down.

The origin is 2 cm in front of that axis, so that a scene can align the mallet with a line.
"""

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import transform

HEAD_X_M = -0.02
RADIUS_M, HEIGHT_M = 0.018, 0.060  # of the head
COLLAR_RADIUS_M, COLLAR_M = 0.0165, 0.036  # painted middle of the head, slightly thinner
HANDLE_END_M, HANDLE_HALF_M, HANDLE_Z_M = -0.20, (0.011, 0.010), 0.030  # half extents in y and z
POMMEL_HALF_M = 0.013  # in x and y; the mallet rests on it, level
WRAP_M, VISUAL_OFFSET_M = (-0.135, -0.195), 0.0005  # wrap around the handle, visual only
GRIP_X_M = -0.095  # near the centre of mass, so that it hangs level

WOOD, STEEL, YELLOW, BLACK = (0.52, 0.27, 0.09), (0.20, 0.21, 0.23), (0.75, 0.42, 0.02), (0.03, 0.03, 0.03)


def build() -> Asset:
    """The mallet with grasp point `handle` and tool point `head`."""
    end_m = (HEIGHT_M - COLLAR_M) / 2
    head = [
        Part.cylinder(RADIUS_M, end_m, transform((HEAD_X_M, 0, z)), STEEL, roughness=0.35, metallic=0.3)
        for z in ((HEIGHT_M - COLLAR_M) / 4, HEIGHT_M - (HEIGHT_M - COLLAR_M) / 4)
    ]
    collar = Part.cylinder(COLLAR_RADIUS_M, COLLAR_M, transform((HEAD_X_M, 0, HEIGHT_M / 2)), YELLOW)
    handle = _bar(HEAD_X_M, HANDLE_END_M, 0.0, WOOD)
    wrap = _bar(*WRAP_M, VISUAL_OFFSET_M, BLACK, solid=False)
    top_m = HANDLE_Z_M + HANDLE_HALF_M[1] + 0.002
    half = (POMMEL_HALF_M, POMMEL_HALF_M, top_m / 2)
    pommel = Part.box(half, transform((HANDLE_END_M, 0, top_m / 2)), BLACK)
    return Asset(
        "hammer",
        parts=(*head, collar, handle, wrap, pommel),
        points={
            "handle": InteractionPoint.from_above((GRIP_X_M, 0, HANDLE_Z_M), width_m=2 * HANDLE_HALF_M[0]),
            "head": InteractionPoint.from_above((HEAD_X_M, 0, 0), "tool"),
        },
        mass_kg=0.12,
        friction=1.2,
    )


def _bar(from_x_m: float, to_x_m: float, offset_m: float, colour, **keywords) -> Part:
    """A piece of the handle between two places along it."""
    half = ((from_x_m - to_x_m) / 2, HANDLE_HALF_M[0] + offset_m, HANDLE_HALF_M[1] + offset_m)
    return Part.box(half, transform(((from_x_m + to_x_m) / 2, 0, HANDLE_Z_M)), colour, **keywords)
