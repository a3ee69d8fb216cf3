"""A box camera on a flat base, with a handle on either side, a lens along +x and a red shutter button.

Two grippers grasp it at a slant from outside and above, which leaves the space above the button to a third.
"""

import numpy as np

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import Matrix, from_axes, transform

BODY_HALF_M = (0.030, 0.070)  # along x, the viewing direction, and y
BASE_HALF_M, BASE_M = (0.045, 0.050), 0.010  # smaller than the top of a plinth
TOP_M = 0.100  # of the body
BRIGHT_M = 0.026  # height of the bright top of the body
LENS_RADIUS_M, LENS_M, LENS_Z_M = 0.031, 0.030, 0.046  # LENS_M is the length outside the body
BUTTON_RADIUS_M, BUTTON_M = 0.011, 0.008
HANDLE_M = (0.066, 0.145)  # along y; the inner end is inside the body
HANDLE_Z_M, HANDLE_HALF_M, CHAMFER_M = (0.020, 0.080), 0.012, 0.015  # the palm clears the cut corners
GRIP_Y_M, GRIP_Z_M = 0.125, 0.050
SLANT = np.sqrt(0.5)  # sine and cosine of 45 deg
PRESS_M = 0.005  # TCP above the button: closed fingertips, 10 mm beyond the TCP, push 5 mm down
VISUAL_OFFSET_M = 0.0008  # how far visual parts stand out of the body

LEATHER, SILVER, RUBBER = (0.035, 0.032, 0.035), (0.55, 0.56, 0.58), (0.02, 0.02, 0.022)
GLASS, FLASH, RED = (0.02, 0.05, 0.14), (0.80, 0.80, 0.72), (0.75, 0.02, 0.02)


def build() -> Asset:
    """The camera with grasp points `left` (y < 0) and `right`, press point `shutter`, tool point `lens`."""
    button = Part.cylinder(BUTTON_RADIUS_M, BUTTON_M, transform((0, 0, TOP_M + BUTTON_M / 2)), RED)
    return Asset(
        "camera",
        parts=(*_body(), *_lens(), button, _handle(-1), _handle(1), *_fittings()),
        points={
            "left": _grip(-1),
            "right": _grip(1),
            "shutter": InteractionPoint.from_above((0, 0, TOP_M + BUTTON_M + PRESS_M), "press", turns=8),
            "lens": InteractionPoint(_ahead(BODY_HALF_M[0] + LENS_M), "tool"),
        },
        mass_kg=0.25,
        friction=1.2,
    )


def _body() -> tuple[Part, Part, Part]:
    """The base, the leather of the body and its bright top."""
    bright_z_m, half_m = TOP_M - BRIGHT_M, BRIGHT_M / 2
    middle = transform((0, 0, (bright_z_m + BASE_M) / 2))
    return (
        Part.box((*BASE_HALF_M, BASE_M / 2), transform((0, 0, BASE_M / 2)), RUBBER),
        Part.box((*BODY_HALF_M, (bright_z_m - BASE_M) / 2), middle, LEATHER, roughness=0.8),
        Part.box((*BODY_HALF_M, half_m), transform((0, 0, TOP_M - half_m)), SILVER, roughness=0.35),
    )


def _lens() -> tuple[Part, Part, Part, Part]:
    """A barrel with a bright ring, and dark glass set in its front."""
    front_m = BODY_HALF_M[0] + LENS_M
    return (
        _along_x(LENS_RADIUS_M, BODY_HALF_M[0], front_m, RUBBER),
        _along_x(LENS_RADIUS_M + VISUAL_OFFSET_M, front_m - 0.012, front_m - 0.006, SILVER, solid=False),
        _along_x(0.80 * LENS_RADIUS_M, front_m - 0.002, front_m + VISUAL_OFFSET_M / 2, SILVER, solid=False),
        _along_x(
            0.70 * LENS_RADIUS_M,
            front_m - 0.002,
            front_m + VISUAL_OFFSET_M,
            GLASS,
            solid=False,
            roughness=0.1,
        ),
    )


def _along_x(radius_m: float, from_x_m: float, to_x_m: float, colour, **keywords) -> Part:
    """A cylinder about the lens' axis between two places along it."""
    middle = _ahead((from_x_m + to_x_m) / 2)
    return Part.cylinder(radius_m, to_x_m - from_x_m, middle, colour, **keywords)


def _ahead(x_m: float) -> Matrix:
    """A pose on the lens' axis, z along it."""
    return from_axes((x_m, 0, LENS_Z_M), z=(1, 0, 0), y=(0, 1, 0))


def _handle(side: int) -> Part:
    """An upright plate whose outer corners are cut."""
    (inner_m, outer_m), (low_m, high_m) = HANDLE_M, HANDLE_Z_M
    inner = (inner_m, low_m), (inner_m, high_m)
    upper = (outer_m - CHAMFER_M, high_m), (outer_m, high_m - CHAMFER_M)
    outline = (*inner, *upper, (outer_m, low_m + CHAMFER_M), (outer_m - CHAMFER_M, low_m))
    corners = [(x, side * y, z) for x in (-HANDLE_HALF_M, HANDLE_HALF_M) for y, z in outline]
    return Part.hull(np.array(corners), RUBBER, roughness=0.9)


def _fittings() -> tuple[Part, ...]:
    """Visual parts: flash and viewfinder window in front, eyepiece at the back, a dial on top."""
    front_m, upper_m = BODY_HALF_M[0], TOP_M - BRIGHT_M / 2

    def window(x_m: float, y_m: float, half_m: tuple[float, float], colour) -> Part:
        return Part.box((VISUAL_OFFSET_M, *half_m), transform((x_m, y_m, upper_m)), colour, solid=False)

    return (
        window(front_m, 0.048, (0.014, 0.008), FLASH),
        window(front_m, -0.048, (0.010, 0.007), GLASS),
        window(-front_m, -0.048, (0.008, 0.006), GLASS),
        Part.cylinder(0.011, 0.004, transform((0, 0.048, TOP_M + 0.002)), RUBBER, solid=False),
    )


def _grip(side: int) -> InteractionPoint:
    """A grasp from outside and above; the fingers close on both faces of the handle."""
    pose = from_axes((0, side * GRIP_Y_M, GRIP_Z_M), z=(0, -side * SLANT, -SLANT), y=(1, 0, 0))
    return InteractionPoint(pose, "grasp", width_m=2 * HANDLE_HALF_M)
