"""A raw steak: a rounded slab of red meat between rinds of fat, with marbling and a bone on top."""

import numpy as np

from rf_exp.tasks.assets.asset.base import Asset, InteractionPoint, Part
from rf_exp.transforms import planar

HALF_M = (0.045, 0.025)  # along x and y
HEIGHT_M = 0.025
GRIP_Z_M = 0.016  # fingertips end 6 mm above the table
BEVEL_M = 0.004

MEAT, FAT, BONE = (0.45, 0.03, 0.03), (0.80, 0.55, 0.42), (0.86, 0.80, 0.66)


def build() -> Asset:
    """The steak with grasp point `center`."""
    levels = ((BEVEL_M, 0.0), (0.0, BEVEL_M), (0.0, HEIGHT_M - BEVEL_M), (BEVEL_M, HEIGHT_M))
    slab = np.concatenate([_outline(inset_m, z_m) for inset_m, z_m in levels])
    face = np.concatenate([_outline(0.0085, HEIGHT_M - 0.001), _outline(0.009, HEIGHT_M + 0.0006)])
    marbling = [
        Part.box((0.014, 0.0016, 0.0006), planar(x, y, np.deg2rad(yaw), HEIGHT_M + 0.0008), FAT, solid=False)
        for x, y, yaw in ((-0.012, 0.006, 20), (0.012, -0.006, 35))
    ]
    bone = Part.cylinder(0.006, 0.0016, planar(0.024, 0.007, 0.0, HEIGHT_M + 0.0008), BONE, solid=False)
    return Asset(
        "steak",
        parts=(Part.hull(slab, FAT), Part.hull(face, MEAT, solid=False), *marbling, bone),
        points={"center": InteractionPoint.from_above((0, 0, GRIP_Z_M), width_m=2 * HALF_M[1])},
        mass_kg=0.12,
        friction=1.2,
    )


def _outline(inset_m: float, z_m: float) -> np.ndarray:
    """Points (24, 3) of the rounded outline: a superellipse with nearly flat long sides."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    cos, sin = np.cos(angles), np.sin(angles)
    x = (HALF_M[0] - inset_m) * np.sign(cos) * np.abs(cos) ** 0.5
    y = (HALF_M[1] - inset_m) * np.sign(sin) * np.abs(sin) ** 0.5
    return np.column_stack([x, y, np.full(24, z_m)])
