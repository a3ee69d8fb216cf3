"""Clutter: objects on the table that no task involves, drawn from the scene's seed and placed off its zones.

The zones, which no piece enters, are where objects of the task may start under any seed, the task's named
places, the approaches of grippers to both, and the areas at and under arms at rest. The space that arms cross
in between is not kept free. A piece has a few convex parts in two colours, its origin on its underside, and a
shape of one of two sets.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from shapely import LineString, MultiPoint, Point, box, get_coordinates, unary_union
from shapely.geometry.base import BaseGeometry

from rf_exp.tasks.assets import Asset, Colour, Part
from rf_exp.tasks.task.specs import TABLE_CENTRE_M, TABLE_M
from rf_exp.transforms import Matrix, planar, transform

if TYPE_CHECKING:
    from rf_exp.tasks.task.task import Task

MARGIN_M = 0.12  # around objects and places: slightly more than half an open gripper
BASE_CLEARANCE_M = 0.25  # around a base
ARM_CLEARANCE_M = 0.15  # beside the line from a base to its TCP at rest
MIN_GAP_M = 0.03  # least distance between two pieces
EDGE_MARGIN_M = 0.05  # least distance to the table's edge
TRIES = 100  # draws of the position of a piece
DENSITY_KG_M3 = 300.0  # most are hollow
SIDES = 16  # of the polygon of a round part
VISUAL_OFFSET_M = 0.0005  # how far parts without collision stand out

Size = tuple[float, float, float]  # metres along x, y, z
BuildParts = Callable[[Size, Colour, Colour], list[Part]]


def _revolved(profile: list[tuple[float, float]], colour: Colour, **keywords) -> Part:
    """The solid of revolution of a convex profile of (radius, height) about z."""
    angles = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    unit_circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [np.column_stack([radius_m * unit_circle, np.full(SIDES, z_m)]) for radius_m, z_m in profile]
    return Part.hull(np.concatenate(rings), colour, **keywords)


def _block(size_m: Size, bottom_m: float, colour: Colour, **keywords) -> Part:
    x, y, z = size_m
    return Part.box((x / 2, y / 2, z / 2), transform((0, 0, bottom_m + z / 2)), colour, **keywords)


def _box(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    x, y, z = size
    band = _block((x + 2 * VISUAL_OFFSET_M, y + 2 * VISUAL_OFFSET_M, 0.3 * z), 0.4 * z, accent, solid=False)
    return [_block(size, 0.0, colour), band]


def _can(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    body = _revolved([(0.9 * radius, 0), (radius, 0.05 * z), (radius, 0.95 * z), (0.9 * radius, z)], accent)
    return [
        body,
        _revolved(
            [(radius + VISUAL_OFFSET_M, 0.1 * z), (radius + VISUAL_OFFSET_M, 0.9 * z)], colour, solid=False
        ),
    ]


def _bottle(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    return [
        _revolved([(radius, 0), (radius, 0.6 * z)], colour),
        _revolved([(radius, 0.6 * z), (0.4 * radius, 0.8 * z)], colour),
        _revolved([(0.4 * radius, 0.8 * z), (0.4 * radius, z)], accent),
    ]


def _mug(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    inside = _revolved(
        [(0.85 * radius, z - VISUAL_OFFSET_M), (0.85 * radius, z + VISUAL_OFFSET_M)], accent, solid=False
    )
    return [_revolved([(0.85 * radius, 0), (radius, z)], colour), inside]


def _book(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    x, y, z = size
    pages = _block((x + 2 * VISUAL_OFFSET_M, 0.98 * y, 0.7 * z), 0.15 * z, accent, solid=False)
    return [_block(size, 0.0, colour), pages]


def _ball(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    """A ball with a flat underside, so that it does not roll."""
    radius = size[0] / 2
    heights = np.linspace(-0.85, 1, 9) * radius
    radii = np.sqrt(np.maximum(radius**2 - heights**2, 0.0))
    return [_revolved([(r, h - heights[0]) for r, h in zip(radii, heights, strict=True)], colour)]


def _bowl(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    inside = _revolved(
        [(0.9 * radius, z - VISUAL_OFFSET_M), (0.9 * radius, z + VISUAL_OFFSET_M)], accent, solid=False
    )
    return [_revolved([(0.5 * radius, 0), (0.85 * radius, 0.4 * z), (radius, z)], colour), inside]


def _jar(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    body = _revolved(
        [(0.8 * radius, 0), (radius, 0.3 * z), (radius, 0.6 * z), (0.7 * radius, 0.8 * z)], colour
    )
    return [body, _revolved([(0.75 * radius, 0.8 * z), (0.75 * radius, z)], accent)]


def _wedge(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    x, y, z = np.array(size) / (2, 2, 1)
    return [
        Part.hull(np.array([(a, b, 0) for a in (-x, x) for b in (-y, y)] + [(-x, 0, z), (x, 0, z)]), colour)
    ]


def _cone(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    radius, z = size[0] / 2, size[2]
    foot = _block((size[0], size[0], 0.1 * z), 0.0, accent)
    return [foot, _revolved([(0.8 * radius, 0.1 * z), (0.15 * radius, z)], colour)]


def _carton(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    """A milk carton: a block with a gable."""
    x, y, z = size
    gable = [(a, b, 0.75 * z) for a in (-x / 2, x / 2) for b in (-y / 2, y / 2)]
    ridge = [(a, 0, z) for a in (-x / 2, x / 2)]
    return [_block((x, y, 0.75 * z), 0.0, colour), Part.hull(np.array(gable + ridge), accent)]


def _tower(size: Size, colour: Colour, accent: Colour) -> list[Part]:
    """Two stacked blocks as one piece."""
    x, y, z = size
    return [_block((x, y, 0.55 * z), 0.0, colour), _block((0.6 * x, 0.6 * y, 0.45 * z), 0.55 * z, accent)]


# Set -> kind -> (build function, smallest size, largest size). Round pieces are as wide as long.
CLUTTER_KINDS: Mapping[str, Mapping[str, tuple[BuildParts, Size, Size]]] = {
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


@lru_cache(maxsize=256)  # bounded: pieces differ from scene to scene
def clutter_asset(clutter_set: str, kind: str, size_m: Size, colour: Colour, accent: Colour) -> Asset:
    """The asset of a kind of clutter in two colours; the same instance for the same arguments."""
    build, _, _ = CLUTTER_KINDS[clutter_set][kind]
    parts = tuple(build(size_m, colour, accent))
    volume_m3 = sum(part.mesh.volume for part in parts if part.solid)
    return Asset(kind, parts, mass_kg=DENSITY_KG_M3 * float(volume_m3))


@dataclass(frozen=True)
class Clutter:
    """One piece of clutter and its place."""

    set: str  # seen | unseen
    kind: str
    size_m: tuple[float, float, float]  # along x, y, z
    colours: tuple[Colour, Colour]  # linear RGB
    yaw_deg: float
    x_m: float = 0.0
    y_m: float = 0.0

    @property
    def asset(self) -> Asset:
        return clutter_asset(self.set, self.kind, self.size_m, *self.colours)

    @cached_property
    def world_from_object(self) -> Matrix:
        return planar(self.x_m, self.y_m, np.deg2rad(self.yaw_deg))


def random_piece(clutter_set: str, rng: np.random.Generator) -> Clutter:
    """A random piece of a set, without a place yet. The two sets share neither shapes nor hues."""
    kind = rng.choice([*CLUTTER_KINDS[clutter_set]]).item()
    _, smallest, largest = CLUTTER_KINDS[clutter_set][kind]
    x, y, z = (np.array(smallest) + rng.uniform(size=3) * np.subtract(largest, smallest)).tolist()
    if smallest[0] == smallest[1]:  # round
        y = x
    colours = _colour(clutter_set, rng), _colour(clutter_set, rng)
    return Clutter(clutter_set, kind, (x, y, z), colours, float(rng.uniform(-180, 180)))


def _colour(clutter_set: str, rng: np.random.Generator) -> Colour:
    """A random colour of a set: each set has every other one of six sectors of the hue circle."""
    sector, position = rng.integers(3), rng.uniform()
    value, saturation = rng.uniform((0.15, 0.35), (0.8, 0.95))
    hue = 2 * sector + position + (clutter_set == "unseen")
    channels = np.clip(np.abs((hue + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    red, green, blue = (value * (1 - saturation * (1 - channels))).tolist()
    return red, green, blue


def place_pieces(
    task: "Task", places: Mapping[str, Matrix], pieces: tuple[Clutter, ...], stream: list[int]
) -> dict[str, Clutter]:
    """Name -> placed piece, for the pieces that found a free place within TRIES draws.

    `places` are the task's named places. Each piece has its own stream of random numbers.
    """
    keep_out, centre = zones(task, places)
    (x, y), (half_x, half_y) = TABLE_CENTRE_M, np.array(TABLE_M[:2]) / 2 - EDGE_MARGIN_M
    table = box(x - half_x, y - half_y, x + half_x, y + half_y)
    placed: dict[str, Clutter] = {}
    outlines: list[BaseGeometry] = []
    for number, piece in enumerate(pieces):
        rng = np.random.default_rng([*stream, 1 + number])
        for _ in range(TRIES):
            x_m, y_m = (centre + rng.uniform(-1, 1, 2) * task.variation.clutter_area_m).tolist()
            candidate = replace(piece, x_m=x_m, y_m=y_m)
            outline = MultiPoint(candidate.asset.vertices(candidate.world_from_object)[:, :2]).convex_hull
            crowded = any(outline.distance(other) < MIN_GAP_M for other in outlines)
            if table.contains(outline) and not crowded and not keep_out.intersects(outline):
                outlines.append(outline)
                placed[f"clutter{number + 1}"] = candidate
                break
    return placed


def zones(task: "Task", places: Mapping[str, Matrix]) -> tuple[BaseGeometry, NDArray[np.float64]]:
    """The area that clutter keeps off, seen from above, and the centre (2,) of the objects' starts."""
    keep_out: list[BaseGeometry] = []
    starts = _start_areas(task)
    widest_m = 0.0
    for name, corners in starts.items():
        asset = task.asset(name)
        radius_m = footprint_radius_m(asset)
        keep_out.append(MultiPoint(corners).convex_hull.buffer(radius_m + MARGIN_M))
        if asset.hulls and not asset.static:
            widest_m = max(widest_m, radius_m)
    keep_out += [Point(pose[:2, 3]).buffer(widest_m + MARGIN_M) for pose in places.values()]
    for robot, arm in zip(task.robots, task.arms.values(), strict=True):
        base_xy, tcp_xy = arm.world_from_base[:2, 3], arm.tcp(robot.rest_qpos)[:2, 3]
        keep_out += [
            Point(base_xy).buffer(BASE_CLEARANCE_M),
            LineString([base_xy, tcp_xy]).buffer(ARM_CLEARANCE_M),
        ]
    all_corners = np.concatenate([*starts.values()])
    return unary_union(keep_out), (all_corners.min(axis=0) + all_corners.max(axis=0)) / 2


def footprint_radius_m(asset: Asset) -> float:
    """Horizontal radius about the origin that covers an object and the standoffs of its approaches."""
    corners = [part.mesh.vertices[:, :2] for part in asset.parts]
    for point in asset.points.values():
        pose = point.object_from_tcp
        corners += [pose[None, :2, 3], (pose[:2, 3] - point.standoff_m * pose[:2, 2])[None]]
    return float(np.linalg.norm(np.concatenate(corners), axis=1).max())


def _start_areas(task: "Task") -> dict[str, NDArray[np.float64]]:
    """Object -> corners (K, 2) of the area in which its origin may start under any seed."""
    areas: dict[str, NDArray[np.float64]] = {}
    yaw_ranges_deg: dict[str, NDArray[np.float64]] = {}  # object -> (lowest, highest) yaw
    for name, spec in task.objects.items():
        origins = np.array([(x, y) for x in spec.x_m for y in spec.y_m])
        yaw_range_deg = np.array(spec.yaw_deg)
        if (hinge := task.asset(name).hinge) is not None:  # closed as well
            closed = planar(spec.x_m[0], spec.y_m[0], np.deg2rad(spec.yaw_deg[0]))
            origins = np.concatenate(
                [origins, (closed @ hinge.closed_from_object(np.deg2rad(spec.open_deg)))[None, :2, 3]]
            )
        if spec.relative_to is not None:
            low, high = yaw_ranges_deg[spec.relative_to]
            yaws = np.deg2rad(np.linspace(low, high, 2 + int((high - low) // 15)))
            origins = np.concatenate([origins @ planar(0, 0, yaw)[:2, :2].T for yaw in yaws])
            origins = (areas[spec.relative_to][:, None] + origins).reshape(-1, 2)
            yaw_range_deg = yaw_range_deg + yaw_ranges_deg[spec.relative_to]
        areas[name] = get_coordinates(MultiPoint(origins).convex_hull)
        yaw_ranges_deg[name] = yaw_range_deg
    return areas
