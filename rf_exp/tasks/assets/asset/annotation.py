"""The annotation of a mesh as YAML: where the mesh is, what it weighs, and where to interact with it.

The vocabulary is that of `InteractionPoint`, with directions instead of matrices. docs/assets.md
explains every field.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import dacite
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks.assets.asset.base import Asset, Colour, InteractionPoint
from rf_exp.transforms import Matrix, from_axes, transform

Vector = tuple[float, float, float]

COMES_ALONG: Mapping[str, Vector | None] = {  # kind -> z axis of its frame unless the file gives one
    "grasp": None,
    "press": None,
    "tool": None,
    "place": (0.0, 0.0, 1.0),
    "drop": (0.0, 0.0, 1.0),
}
DIGITS = 6  # of what is written


@dataclass(frozen=True)
class Frame:
    """Where the mesh stands in the frame of the asset, after scaling."""

    position_m: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)  # about the fixed x, then y, then z axis

    @property
    def asset_from_mesh(self) -> Matrix:
        return transform(self.position_m, Rotation.from_euler("xyz", self.rotation_deg, degrees=True))


@dataclass(frozen=True)
class Point:
    """An InteractionPoint with its frame as two directions."""

    kind: str
    position_m: Vector
    approach: Vector | None = None  # z axis of the frame
    fingers: Vector = (0.0, 1.0, 0.0)  # y axis of the frame, as far as it is perpendicular to z
    standoff_m: float = InteractionPoint.standoff_m
    width_m: float = InteractionPoint.width_m
    turns: int = InteractionPoint.turns
    tip_deg: float = InteractionPoint.tip_deg
    slack_m: float = InteractionPoint.slack_m

    def interaction_point(self) -> InteractionPoint:
        """Raises ArgumentError for an unknown kind and for directions that make no frame."""
        if self.kind not in COMES_ALONG:
            raise choices("kind", self.kind, COMES_ALONG)
        approach = self.approach or COMES_ALONG[self.kind]
        if approach is None:
            raise ArgumentError(f'missing value for field "approach"; a {self.kind} point needs one')
        if not np.any(approach) or np.linalg.norm(np.cross(approach, self.fingers)) < 1e-9:
            raise ArgumentError(
                f"approach {approach} and fingers {self.fingers}; expected directions that are not parallel"
            )
        return InteractionPoint(
            from_axes(self.position_m, z=approach, y=self.fingers),
            self.kind,
            standoff_m=self.standoff_m,
            width_m=self.width_m,
            turns=self.turns,
            tip_deg=self.tip_deg,
            slack_m=self.slack_m,
        )

    @staticmethod
    def of(point: InteractionPoint) -> "Point":
        _, y, z = point.object_from_tcp[:3, :3].T
        return Point(
            kind=point.kind,
            position_m=_plain(point.object_from_tcp[:3, 3]),
            approach=_plain(z),
            fingers=_plain(y),
            standoff_m=point.standoff_m,
            width_m=point.width_m,
            turns=point.turns,
            tip_deg=point.tip_deg,
            slack_m=point.slack_m,
        )


@dataclass(frozen=True)
class Annotation:
    """What a YAML file says about a mesh."""

    mesh: str  # obj, glb, stl or ply; a path from the folder of the annotation
    mass_kg: float
    heaviest_kg: float | None = None  # of its heaviest make
    friction: float = Asset.friction
    scale: float = 1.0  # metres for one unit of the mesh
    static: bool = Asset.static
    colour: Colour | None = None  # linear RGB in [0, 1]; without it the mesh's own
    frame: Frame = Frame()
    points_of: str | None = None  # take the points of this built-in asset
    points: Mapping[str, Point] = field(default_factory=dict)  # beside or instead of those

    def __post_init__(self) -> None:
        for name in ("mass_kg", "friction", "scale"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ArgumentError(f"{name} is {value}; expected a number above 0")
        if self.heaviest_kg is not None and not self.mass_kg <= self.heaviest_kg < np.inf:
            raise ArgumentError(
                f"heaviest_kg is {self.heaviest_kg}; expected mass_kg ({self.mass_kg}) or more"
            )
        if self.colour is not None and not all(0 <= value <= 1 for value in self.colour):
            raise ArgumentError(f"colour is {self.colour}; expected three numbers from 0 to 1")


def read(path: Path) -> Annotation:
    """The annotation in a file. Raises ArgumentError that names the file and what is wrong in it."""
    try:
        node: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArgumentError(f"there is no annotation file {path}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ArgumentError(f"annotation {path} cannot be read: {error}") from error
    if not isinstance(node, dict):
        raise ArgumentError(f"annotation {path}: expected fields and their values, got {node!r}")
    try:
        return dacite.from_dict(Annotation, node, config=dacite.Config(cast=[tuple], strict=True))
    except (dacite.DaciteError, ArgumentError) as error:
        raise ArgumentError(f"annotation {path}: {error}") from error


def write(asset: Asset, mesh: str) -> str:
    """The annotation of an asset as YAML text that names `mesh` as its mesh file."""
    node = {
        "mesh": mesh,
        "scale": 1.0,
        "mass_kg": asset.mass_kg,
        "heaviest_kg": asset.heaviest_kg,
        "friction": asset.friction,
        "static": asset.static,
        "frame": {"position_m": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 0.0]},
        "points": {name: _fields(Point.of(point)) for name, point in asset.points.items()},
    }
    return yaml.safe_dump(node, sort_keys=False, default_flow_style=None)


def _fields(point: Point) -> dict[str, Any]:
    values = {each.name: getattr(point, each.name) for each in fields(Point)}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def _plain(vector: np.ndarray) -> Vector:
    x, y, z = (np.round(vector, DIGITS) + 0.0).tolist()  # + 0.0: no -0.0
    return x, y, z
