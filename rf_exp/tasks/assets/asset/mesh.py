"""Assets from a user's own mesh and its annotation: `asset: my_shoe.yaml` in a task.

The annotation holds the path of the mesh, the mass, and interaction points as in `InteractionPoint`, with
directions instead of matrices. docs/assets.md explains every field. Every closed shell of the mesh becomes
convex solid parts that are not rendered; the mesh itself is rendered, without collision.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import dacite
import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh.visual import ColorVisuals, uv_to_color

from rf_exp.errors import ArgumentError, error_context, unknown_choice
from rf_exp.tasks import assets
from rf_exp.tasks.assets.asset.base import Asset, Colour, Hinge, InteractionPoint, Part, convex_pieces
from rf_exp.transforms import from_axes, transform

Vector = tuple[float, float, float]

DEFAULT_APPROACH: Mapping[str, Vector | None] = {  # kind -> default of the frame's z axis; None: required
    **dict.fromkeys(("grasp", "press", "shut", "tool")),
    **dict.fromkeys(("place", "drop"), (0.0, 0.0, 1.0)),
}
DIGITS = 6  # of written numbers
MAX_OPEN_DEG = 170.0  # largest opening of a hinge
HINGE_FIELDS = ("open_deg", "falls_deg", "falls_s", "damping_n_m_s")  # fields shared with Hinge
# fields shared with InteractionPoint
POINT_FIELDS = ("kind", "standoff_m", "width_m", "turns", "around", "tip_deg", "slack_m")
BODY_FIELDS = ("mass_kg", "heaviest_kg", "friction", "static")  # fields shared with Asset
FORMATS = (".glb", ".obj", ".ply", ".stl")
LINEAR_FORMATS = (".glb",)  # formats with linear colours, except textures; in all others colours are sRGB
GREY: Colour = (0.35, 0.35, 0.35)
MAX_COLOURS = 16  # above this number, similar colours are merged
TABLE_TOLERANCE_M = 0.001  # largest distance of the lowest point from z = 0


@dataclass(frozen=True)
class Frame:
    """Pose of the scaled mesh in the asset's frame."""

    position_m: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)  # about the fixed x, then y, then z axis


@dataclass(frozen=True)
class Point:
    """An InteractionPoint whose frame is given by two directions."""

    kind: str
    position_m: Vector
    approach: Vector | None = None  # z axis of the frame
    fingers: Vector = (0.0, 1.0, 0.0)  # y axis of the frame, made perpendicular to z
    standoff_m: float = InteractionPoint.standoff_m
    width_m: float = InteractionPoint.width_m
    turns: int = InteractionPoint.turns
    around: int = InteractionPoint.around
    tip_deg: float = InteractionPoint.tip_deg
    slack_m: float = InteractionPoint.slack_m

    def interaction_point(self) -> InteractionPoint:
        """Raises ArgumentError for an unknown kind, a missing approach, and parallel directions."""
        if self.kind not in DEFAULT_APPROACH:
            raise unknown_choice("kind", self.kind, DEFAULT_APPROACH)
        approach = self.approach or DEFAULT_APPROACH[self.kind]
        if approach is None:
            raise ArgumentError(f'missing value for field "approach"; a {self.kind} point needs one')
        if not np.any(approach) or np.linalg.norm(np.cross(approach, self.fingers)) < 1e-9:
            raise ArgumentError(
                f"approach {approach} and fingers {self.fingers}; expected directions that are not parallel"
            )
        pose = from_axes(self.position_m, z=approach, y=self.fingers)
        return InteractionPoint(pose, **{name: getattr(self, name) for name in POINT_FIELDS})

    @staticmethod
    def of(point: InteractionPoint) -> "Point":
        _, y, z = point.object_from_tcp[:3, :3].T
        shared_fields = {name: getattr(point, name) for name in POINT_FIELDS}
        position_m = _rounded_vector(point.object_from_tcp[:3, 3])
        return Point(
            position_m=position_m, approach=_rounded_vector(z), fingers=_rounded_vector(y), **shared_fields
        )


@dataclass(frozen=True)
class HingeSpec:
    """A hinge in an annotation; see `Hinge`."""

    position_m: Vector  # a point on the axis
    open_deg: float
    falls_deg: float
    falls_s: float
    damping_n_m_s: float
    axis: Vector = (0.0, 1.0, 0.0)  # a positive rotation about it opens the object

    def hinge(self) -> Hinge:
        """Raises ArgumentError for a zero axis and for angles out of bounds."""
        if not np.any(self.axis):
            raise ArgumentError("axis of the hinge is (0, 0, 0); expected a direction")
        if not 0 <= self.falls_deg < self.open_deg <= MAX_OPEN_DEG:
            raise ArgumentError(
                f"the hinge has falls_deg {self.falls_deg:g} and open_deg {self.open_deg:g}; expected "
                f"0 <= falls_deg < open_deg <= {MAX_OPEN_DEG:g}"
            )
        across = np.eye(3)[np.abs(self.axis).argmin()]
        pose = from_axes(self.position_m, z=np.cross(across, self.axis), y=self.axis)
        return Hinge(pose, **{name: getattr(self, name) for name in HINGE_FIELDS})

    @staticmethod
    def of(hinge: Hinge) -> "HingeSpec":
        pose = hinge.object_from_hinge
        shared_fields = {name: getattr(hinge, name) for name in HINGE_FIELDS}
        return HingeSpec(
            position_m=_rounded_vector(pose[:3, 3]), axis=_rounded_vector(pose[:3, 1]), **shared_fields
        )


@dataclass(frozen=True)
class Annotation:
    """Annotation of a mesh, as in a YAML file."""

    mesh: str  # obj, glb, stl or ply; path relative to the annotation's folder
    mass_kg: float
    heaviest_kg: float | None = None  # as in `Asset`
    friction: float = Asset.friction
    scale: float = 1.0  # metres per unit of the mesh
    static: bool = Asset.static
    colour: Colour | None = None  # linear RGB in [0, 1]; None: the mesh's own
    frame: Frame = Frame()
    hinge: HingeSpec | None = None
    points_of: str | None = None  # built-in asset whose points are taken
    points: Mapping[str, Point] = field(default_factory=dict)  # added to those, or replacing them

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
    """The annotation in a file. Raises ArgumentError that names the file and the error."""
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
    """The annotation of an asset as YAML text, with `mesh` as its mesh file."""
    points = {name: asdict(Point.of(point)) for name, point in asset.points.items()}
    node = {
        "mesh": mesh,
        "scale": 1.0,
        **{name: getattr(asset, name) for name in BODY_FIELDS},
        "frame": {"position_m": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 0.0]},
        "points": {name: _with_lists(fields) for name, fields in points.items()},
    }
    if asset.hinge is not None:
        node["hinge"] = _with_lists(asdict(HingeSpec.of(asset.hinge)))
    return yaml.safe_dump(node, sort_keys=False, default_flow_style=None)


def _with_lists(values: Mapping[str, Any]) -> dict[str, Any]:
    """The mapping with lists in place of tuples, which YAML lacks."""
    return {key: [*value] if isinstance(value, tuple) else value for key, value in values.items()}


def _rounded_vector(vector: np.ndarray) -> Vector:
    x, y, z = (np.round(vector, DIGITS) + 0.0).tolist()  # + 0.0: no -0.0
    return x, y, z


def build(path: str) -> Asset:
    """The asset of an annotation file. Decomposing a non-convex shell takes one or two seconds.

    Raises ArgumentError for a missing or invalid file, a mesh that is not watertight, and one whose lowest
    point is not at z = 0.
    """
    file = Path(path)
    annotation = read(file)
    with error_context(f"annotation {file}"):
        parts, points = _parts(annotation, file.parent / annotation.mesh), _points(annotation)
        hinge = None if annotation.hinge is None else annotation.hinge.hinge()
        body = {name: getattr(annotation, name) for name in BODY_FIELDS}
        return Asset(file.stem, parts=parts, points=points, hinge=hinge, **body)


def _points(annotation: Annotation) -> dict[str, InteractionPoint]:
    points: dict[str, InteractionPoint] = {}
    if annotation.points_of is not None:
        if annotation.points_of not in assets.available():
            raise unknown_choice("asset in points_of", annotation.points_of, assets.available())
        points |= assets.load(annotation.points_of).points
    for name, point in annotation.points.items():
        with error_context(f"point {name!r}"):
            points[name] = point.interaction_point()
    return points


def _parts(annotation: Annotation, path: Path) -> tuple[Part, ...]:
    """Convex solid parts that are not rendered, and the coloured surface, which is not solid."""
    turn = Rotation.from_euler("xyz", annotation.frame.rotation_deg, degrees=True)
    asset_from_mesh = transform(annotation.frame.position_m, turn)
    parts = []
    for geometry in geometries(path):
        colours = face_colours(geometry, path.suffix.lower() in LINEAR_FORMATS)  # (F, 3)
        # Merge vertices that the file duplicates for shading.
        body = trimesh.Trimesh(geometry.vertices, geometry.faces, process=True)
        body.apply_scale(annotation.scale).apply_transform(asset_from_mesh)
        hulls = [piece for shell in _shells(body, path) for piece in convex_pieces(shell)]
        parts += [Part(piece, GREY, visible=False) for piece in hulls]
        own_colour = annotation.colour
        parts += visual_parts(body, colours if own_colour is None else np.tile(own_colour, (len(colours), 1)))
    lowest_m = min(part.mesh.bounds[0, 2] for part in parts if part.visible)
    if abs(lowest_m) > TABLE_TOLERANCE_M:
        raise ArgumentError(
            f"the lowest point of {path.name} is at z = {lowest_m:.4f} m; expected 0: "
            f"add {-lowest_m:.4f} to the third number of frame.position_m"
        )
    return tuple(parts)


def geometries(path: Path) -> list[trimesh.Trimesh]:
    """The meshes of a file, placed as in its scene, in units of the file."""
    if path.suffix.lower() not in FORMATS:
        raise unknown_choice("mesh format", path.suffix, FORMATS)
    if not path.is_file():
        raise ArgumentError(f"there is no mesh file {path}")
    try:
        dumped = trimesh.load_scene(path).dump()
    except Exception as error:  # every format has its own errors
        raise ArgumentError(f"mesh {path} cannot be read: {error}") from error
    geometries = [mesh for mesh in dumped if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not geometries:
        raise ArgumentError(f"mesh {path} has no triangles")
    return geometries


def _shells(body: trimesh.Trimesh, path: Path) -> list[trimesh.Trimesh]:
    """The connected components of a mesh, each closed, with normals pointing outwards."""
    shells = list(body.split(only_watertight=False, repair=False))
    for shell in shells:
        shell.fix_normals()
        if not shell.is_watertight or shell.volume <= 0:
            open_edges = int((np.bincount(shell.edges_unique_inverse) != 2).sum())
            raise ArgumentError(
                f"mesh {path.name} is not watertight: in a piece of {len(shell.faces)} triangles "
                f"{open_edges} edges do not have a triangle on either side; expected closed surfaces, with "
                "an inside"
            )
    return shells


def face_colours(geometry: trimesh.Trimesh, linear: bool) -> NDArray[np.float64]:
    """Linear RGB (F, 3) in [0, 1] of the triangles: their own, their material's, or their texture's."""
    visual: Any = geometry.visual
    count = len(geometry.faces)
    if not visual.defined:
        return np.tile(GREY, (count, 1))
    if isinstance(visual, ColorVisuals):
        rgba = np.asarray(visual.face_colors)
    else:
        image = getattr(visual.material, "baseColorTexture", getattr(visual.material, "image", None))
        if image is None or visual.uv is None:
            rgba = np.tile(visual.material.main_color, (count, 1))
        else:
            rgba, linear = uv_to_color(visual.uv, image)[geometry.faces].mean(axis=1), False
    rgb = rgba[:, :3] / 255.0
    return rgb if linear else np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def visual_parts(body: trimesh.Trimesh, colours: NDArray[np.float64]) -> list[Part]:
    """One visual part per colour; above COLOURS, similar colours are merged to their mean."""
    palette, group = np.unique(colours, axis=0, return_inverse=True)
    if len(palette) > MAX_COLOURS:
        palette, group = np.unique(np.round(colours * 3), axis=0, return_inverse=True)  # 4 levels per channel
    parts = []
    for k in range(len(palette)):
        faces = np.flatnonzero(group.ravel() == k)
        red, green, blue = colours[faces].mean(axis=0).tolist()
        mesh: Any = body.submesh([faces], append=True, repair=False)
        parts.append(Part(mesh, (red, green, blue), solid=False))
    return parts
