"""Things that stand about on a table and that no task is about: their shapes, in two sets.

Each is made of a few convex parts and of two colours, and stands on its origin at rest.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks.assets.asset.base import Asset, Colour, Part
from rf_exp.transforms import transform

DENSITY_KG_M3 = 300.0  # most are hollow
SIDES = 16  # of what is round
PROUD_M = 0.0005  # what is only seen stands out so far

Size = tuple[float, float, float]  # metres along x, y, z
Build = Callable[[Size, Colour, Colour], list[Part]]


def _ring(radius_m: float, z_m: float) -> NDArray[np.float64]:
    """(SIDES, 3) points of a level circle."""
    angles = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    return np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(SIDES, z_m)])


def _turned(profile: list[tuple[float, float]], colour: Colour, **keywords) -> Part:
    """What a convex profile of (radius, height) sweeps about z."""
    return Part.hull(np.concatenate([_ring(*each) for each in profile]), colour, **keywords)


def _block(size_m: Size, bottom_m: float, colour: Colour, **keywords) -> Part:
    x, y, z = size_m
    return Part.box((x / 2, y / 2, z / 2), transform((0, 0, bottom_m + z / 2)), colour, **keywords)


def _box(size: Size, colour: Colour, other: Colour) -> list[Part]:
    x, y, z = size
    band = _block((x + 2 * PROUD_M, y + 2 * PROUD_M, 0.3 * z), 0.4 * z, other, solid=False)
    return [_block(size, 0.0, colour), band]


def _can(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    body = _turned([(0.9 * radius, 0), (radius, 0.05 * z), (radius, 0.95 * z), (0.9 * radius, z)], other)
    return [body, _turned([(radius + PROUD_M, 0.1 * z), (radius + PROUD_M, 0.9 * z)], colour, solid=False)]


def _bottle(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    return [
        _turned([(radius, 0), (radius, 0.6 * z)], colour),
        _turned([(radius, 0.6 * z), (0.4 * radius, 0.8 * z)], colour),
        _turned([(0.4 * radius, 0.8 * z), (0.4 * radius, z)], other),
    ]


def _mug(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    inside = _turned([(0.85 * radius, z - PROUD_M), (0.85 * radius, z + PROUD_M)], other, solid=False)
    return [_turned([(0.85 * radius, 0), (radius, z)], colour), inside]


def _book(size: Size, colour: Colour, other: Colour) -> list[Part]:
    x, y, z = size
    pages = _block((x + 2 * PROUD_M, 0.98 * y, 0.7 * z), 0.15 * z, other, solid=False)
    return [_block(size, 0.0, colour), pages]


def _ball(size: Size, colour: Colour, other: Colour) -> list[Part]:
    """Flat where it lies, so that it stays there."""
    radius = size[0] / 2
    heights = np.linspace(-0.85, 1, 9) * radius
    across = np.sqrt(np.maximum(radius**2 - heights**2, 0.0))
    return [_turned([(r, h - heights[0]) for r, h in zip(across, heights, strict=True)], colour)]


def _bowl(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    inside = _turned([(0.9 * radius, z - PROUD_M), (0.9 * radius, z + PROUD_M)], other, solid=False)
    return [_turned([(0.5 * radius, 0), (0.85 * radius, 0.4 * z), (radius, z)], colour), inside]


def _jar(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    body = _turned([(0.8 * radius, 0), (radius, 0.3 * z), (radius, 0.6 * z), (0.7 * radius, 0.8 * z)], colour)
    return [body, _turned([(0.75 * radius, 0.8 * z), (0.75 * radius, z)], other)]


def _wedge(size: Size, colour: Colour, other: Colour) -> list[Part]:
    x, y, z = np.array(size) / (2, 2, 1)
    return [
        Part.hull(np.array([(a, b, 0) for a in (-x, x) for b in (-y, y)] + [(-x, 0, z), (x, 0, z)]), colour)
    ]


def _cone(size: Size, colour: Colour, other: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    foot = _block((size[0], size[0], 0.1 * z), 0.0, other)
    return [foot, _turned([(0.8 * radius, 0.1 * z), (0.15 * radius, z)], colour)]


def _carton(size: Size, colour: Colour, other: Colour) -> list[Part]:
    """Of milk: a block with a gable."""
    x, y, z = size
    gable = [(a, b, 0.75 * z) for a in (-x / 2, x / 2) for b in (-y / 2, y / 2)]
    ridge = [(a, 0, z) for a in (-x / 2, x / 2)]
    return [_block((x, y, 0.75 * z), 0.0, colour), Part.hull(np.array(gable + ridge), other)]


def _tower(size: Size, colour: Colour, other: Colour) -> list[Part]:
    """Two blocks that are one."""
    x, y, z = size
    return [_block((x, y, 0.55 * z), 0.0, colour), _block((0.6 * x, 0.6 * y, 0.45 * z), 0.55 * z, other)]


# Set -> kind -> how it is built, and its smallest and largest size. Round things are as wide as long.
HOUSEHOLD: Mapping[str, Mapping[str, tuple[Build, Size, Size]]] = {
    "seen": {
        "box": (_box, (0.05, 0.04, 0.04), (0.14, 0.10, 0.16)),
        "can": (_can, (0.055, 0.055, 0.08), (0.08, 0.08, 0.13)),
        "bottle": (_bottle, (0.055, 0.055, 0.16), (0.08, 0.08, 0.24)),
        "mug": (_mug, (0.07, 0.07, 0.07), (0.10, 0.10, 0.11)),
        "book": (_book, (0.12, 0.09, 0.015), (0.21, 0.15, 0.04)),
        "ball": (_ball, (0.05, 0.05, 0.05), (0.10, 0.10, 0.10)),
    },
    "unseen": {
        "bowl": (_bowl, (0.10, 0.10, 0.04), (0.16, 0.16, 0.07)),
        "jar": (_jar, (0.06, 0.06, 0.08), (0.10, 0.10, 0.14)),
        "wedge": (_wedge, (0.08, 0.06, 0.03), (0.14, 0.10, 0.08)),
        "cone": (_cone, (0.07, 0.07, 0.10), (0.10, 0.10, 0.18)),
        "carton": (_carton, (0.06, 0.06, 0.14), (0.08, 0.08, 0.22)),
        "tower": (_tower, (0.06, 0.05, 0.08), (0.12, 0.10, 0.16)),
    },
}


@lru_cache(maxsize=256)  # they differ from scene to scene
def household(of: str, kind: str, size_m: Size, colour: Colour, other: Colour) -> Asset:
    """A thing of a kind of one of the two sets, in two colours; the same object for the same arguments."""
    build, _, _ = HOUSEHOLD[of][kind]
    parts = tuple(build(size_m, colour, other))
    volume_m3 = sum(part.mesh.volume for part in parts if part.solid)
    return Asset(kind, parts, mass_kg=DENSITY_KG_M3 * float(volume_m3))
