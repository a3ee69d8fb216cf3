"""Clutter: things on the table that no task is about, drawn by the seed of a scene and placed off its zones.

A piece stands nowhere where an object of the task may start, whatever the seed, where something is put,
where grippers come to either, nor at or under an arm at rest; what an arm crosses in between is left to it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from shapely import LineString, MultiPoint, Point, box, get_coordinates, unary_union
from shapely.geometry.base import BaseGeometry

from rf_exp.tasks.assets import HOUSEHOLD, Asset, Colour, household
from rf_exp.tasks.task.specs import TABLE_CENTRE_M, TABLE_M
from rf_exp.transforms import Matrix, planar

if TYPE_CHECKING:
    from rf_exp.tasks.task.task import Task

MARGIN_M = 0.12  # round things and places: half of an open hand, and a little
BASE_M, ARM_M = 0.25, 0.15  # round a base, and beside the line from it to its hand at rest
APART_M = 0.03  # between two pieces
EDGE_M = 0.05  # to that of the table
TRIES = 100  # draws of where a piece stands


@dataclass(frozen=True)
class Clutter:
    """One piece, and where it stands."""

    set: str  # seen | unseen
    kind: str
    size_m: tuple[float, float, float]  # along x, y, z
    colours: tuple[Colour, Colour]  # linear RGB
    yaw_deg: float
    x_m: float = 0.0
    y_m: float = 0.0

    @property
    def asset(self) -> Asset:
        return household(self.set, self.kind, self.size_m, *self.colours)

    @cached_property
    def world_from_object(self) -> Matrix:
        return planar(self.x_m, self.y_m, np.deg2rad(self.yaw_deg))


def drawn_piece(of: str, rng: np.random.Generator) -> Clutter:
    """A piece that has no place yet. The two sets have shapes and hues of their own."""
    kind = rng.choice([*HOUSEHOLD[of]]).item()
    _, least, most = HOUSEHOLD[of][kind]
    x, y, z = (np.array(least) + rng.uniform(size=3) * np.subtract(most, least)).tolist()
    if least[0] == least[1]:  # it is round
        y = x
    colours = _colour(of, rng), _colour(of, rng)
    return Clutter(of, kind, (x, y, z), colours, float(rng.uniform(-180, 180)))


def _colour(of: str, rng: np.random.Generator) -> Colour:
    """Of six sectors of the circle of hues every other one is of a set."""
    sector, within = rng.integers(3), rng.uniform()
    value, saturation = rng.uniform((0.15, 0.35), (0.8, 0.95))
    hue = 2 * sector + within + (of == "unseen")
    parts = np.clip(np.abs((hue + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    red, green, blue = (value * (1 - saturation * (1 - parts))).tolist()
    return red, green, blue


def placed(
    task: "Task", places: Mapping[str, Matrix], pieces: tuple[Clutter, ...], stream: list[int]
) -> dict[str, Clutter]:
    """Name -> a piece in its place, of those for which one was found: as many draws as tries allow.

    `places` is what the task names. Each piece has a stream of random numbers of its own.
    """
    kept_free, middle = zones(task, places)
    (x, y), (across, along) = TABLE_CENTRE_M, np.array(TABLE_M[:2]) / 2 - EDGE_M
    table = box(x - across, y - along, x + across, y + along)
    found: dict[str, Clutter] = {}
    outlines: list[BaseGeometry] = []
    for number, piece in enumerate(pieces):
        rng = np.random.default_rng([*stream, 1 + number])
        for _ in range(TRIES):
            x_m, y_m = (middle + rng.uniform(-1, 1, 2) * task.variation.clutter_area_m).tolist()
            there = replace(piece, x_m=x_m, y_m=y_m)
            outline = MultiPoint(there.asset.vertices(there.world_from_object)[:, :2]).convex_hull
            near = any(outline.distance(other) < APART_M for other in outlines)
            if table.contains(outline) and not near and not kept_free.intersects(outline):
                outlines.append(outline)
                found[f"clutter{number + 1}"] = there
                break
    return found


def zones(task: "Task", places: Mapping[str, Matrix]) -> tuple[BaseGeometry, NDArray[np.float64]]:
    """What clutter keeps off, seen from above, and (2,) the middle of where objects start."""
    kept_free: list[BaseGeometry] = []
    starts = _starts(task)
    widest_m = 0.0
    for name, corners in starts.items():
        asset = task.asset(name)
        radius_m = reach_m(asset)
        kept_free.append(MultiPoint(corners).convex_hull.buffer(radius_m + MARGIN_M))
        if asset.hulls and not asset.static:
            widest_m = max(widest_m, radius_m)
    kept_free += [Point(pose[:2, 3]).buffer(widest_m + MARGIN_M) for pose in places.values()]
    for robot, arm in zip(task.robots, task.arms.values(), strict=True):
        base, hand = arm.world_from_base[:2, 3], arm.tcp(robot.at_rest)[:2, 3]
        kept_free += [Point(base).buffer(BASE_M), LineString([base, hand]).buffer(ARM_M)]
    everywhere = np.concatenate([*starts.values()])
    return unary_union(kept_free), (everywhere.min(axis=0) + everywhere.max(axis=0)) / 2


def reach_m(asset: Asset) -> float:
    """How far a thing, and where grippers begin to come to it, are from its origin, seen from above."""
    corners = [part.mesh.vertices[:, :2] for part in asset.parts]
    for point in asset.points.values():
        pose = point.object_from_tcp
        corners += [pose[None, :2, 3], (pose[:2, 3] - point.standoff_m * pose[:2, 2])[None]]
    return float(np.linalg.norm(np.concatenate(corners), axis=1).max())


def _starts(task: "Task") -> dict[str, NDArray[np.float64]]:
    """Object -> (K, 2) corners of where its origin may start, whatever the seed."""
    found: dict[str, NDArray[np.float64]] = {}
    turns_deg: dict[str, NDArray[np.float64]] = {}  # object -> its lowest and highest yaw
    for name, spec in task.objects.items():
        own = np.array([(x, y) for x in spec.x_m for y in spec.y_m])
        turn = np.array(spec.yaw_deg)
        if spec.relative_to is not None:
            low, high = turns_deg[spec.relative_to]
            yaws = np.deg2rad(np.linspace(low, high, 2 + int((high - low) // 15)))
            own = np.concatenate([own @ planar(0, 0, yaw)[:2, :2].T for yaw in yaws])
            own = (found[spec.relative_to][:, None] + own).reshape(-1, 2)
            turn = turn + turns_deg[spec.relative_to]
        found[name] = get_coordinates(MultiPoint(own).convex_hull)
        turns_deg[name] = turn
    return found
