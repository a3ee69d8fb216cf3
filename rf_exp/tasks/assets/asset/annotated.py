"""Assets of the authors' release in place of built-in ones: their meshes and annotated points.

    objects/<name>/*.obj, *.glb, *.urdf
    objects/<name>/model_data.json  scale (3); contact_points_pose, functional_matrix, target_pose: 4x4 each

Translations of these poses are in units of the mesh. The gripper approaches along the x axis of
`pose @ HAND_ROTATION` and closes along y. Mass and friction are in none of the files: both are those of the
built-in asset. `released.yaml` maps built-in assets to files.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets
from rf_exp.tasks.assets import Asset, InteractionPoint, Part, convex_pieces
from rf_exp.tasks.assets.asset import links
from rf_exp.tasks.assets.asset.mesh import GREY, LINEAR_FORMATS, face_colours, geometries, visual_parts
from rf_exp.tasks.assets.asset.released import MOVING, release_sources
from rf_exp.texts import printable
from rf_exp.transforms import Matrix, apply, from_axes, inverse, transform

OBJECTS = "objects"  # below the release's folder `assets`
# applied to annotated poses
HAND_ROTATION = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
MAX_OPENING_M = 0.08  # between open fingers
SIZE_RATIOS = (0.5, 2.0)  # bounds of the longest side's ratio to that of the built-in asset
MAX_SHELLS = 256  # most shells that are decomposed one by one
PAD_HALF_WIDTH_M = 0.009  # half the width of a finger pad


@dataclass(frozen=True)
class Shape:
    """Meshes of a release asset in m, in the actor's frame, and the axis of its hinge."""

    bodies: tuple[trimesh.Trimesh, ...]
    colours: tuple[NDArray[np.float64], ...]  # (F, 3) per body
    axis: links.Axis | None

    @property
    def lowest_m(self) -> float:
        return min(float(body.bounds[0, 2]) for body in self.bodies)


def build(folder: str, like: str, **options: Any) -> Asset:
    """The release's counterpart of the built-in asset `like` with `options`, from the files below a folder.

    Raises ArgumentError for files that are missing or not as in the release, and for a size out of bounds.
    """
    builtin, source = assets.load(like, options), release_sources()[like]
    annotation_path = Path(folder) / OBJECTS / source.annotation
    annotation, shape = read_annotation(annotation_path), shape_of(folder, like)
    rotation = transform((0, 0, 0), Rotation.from_quat(source.standing_wxyz, scalar_first=True))
    if source.hinge_of is not None:
        rotation = _hinge_alignment(shape, assets.load(source.hinge_of)) @ rotation
    rotated_bodies = [body.copy().apply_transform(rotation) for body in shape.bodies]
    asset_from_actor = transform((0, 0, -min(float(body.bounds[0, 2]) for body in rotated_bodies))) @ rotation
    bodies = [body.copy().apply_transform(asset_from_actor) for body in shape.bodies]
    parts = [Part(piece, GREY, visible=False) for piece in _collision_meshes(bodies)]
    for body, colours in zip(bodies, shape.colours, strict=True):
        parts += visual_parts(body, colours)
    asset = replace(builtin, name=f"{like}_of_release", parts=tuple(parts))
    _check_size(annotation_path, annotation["scale"], asset, builtin)
    points = {}
    for name, point in builtin.points.items():
        pose = _annotated_pose(
            annotation_path, annotation, source.points.get(name), point.kind, asset_from_actor
        )
        points[name] = _with_grasp_width(
            annotation_path, name, _replaced_point(point, pose, asset, builtin), asset
        )
    hinge = builtin.hinge
    if hinge is not None:
        if shape.axis is None:
            raise ArgumentError(
                f"{Path(folder) / OBJECTS / source.mesh} has no link that turns, as {like} does"
            )
        along = asset_from_actor[:3, :3] @ shape.axis.direction
        across = np.eye(3)[np.abs(along).argmin()]
        position = apply(asset_from_actor, np.array([shape.axis.position * annotation["scale"]]))[0]
        hinge = replace(hinge, object_from_hinge=from_axes(position, z=np.cross(across, along), y=along))
    return replace(asset, points=points, hinge=hinge)


def read_annotation(path: Path) -> Mapping[str, Any]:
    """The annotation of a release asset, `scale` as an array (3,). Raises ArgumentError."""
    try:
        annotation: Any = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise ArgumentError(f"there is no {path}; assets_folder is the release's folder `assets`") from error
    except (OSError, ValueError, RecursionError) as error:
        raise ArgumentError(f"annotation {path} cannot be read: {printable(error)}") from error
    annotation = annotation if isinstance(annotation, dict) else {}
    scale = _array(annotation.get("scale"))
    if scale.shape != (3,) or not (scale > 0).all():
        raise ArgumentError(
            f"annotation {path} has no scale of three numbers above 0; {_keys_text(annotation)}, and "
            "expected are scale, contact_points_pose, functional_matrix and target_pose"
        )
    return {**annotation, "scale": scale}


@cache
def shape_of(folder: str, like: str) -> Shape:
    source = release_sources()[like]
    path, axis = Path(folder) / OBJECTS / source.mesh, None
    visuals = [links.Visual(path, np.eye(4), np.ones(3))]
    if source.link is not None:
        visuals, axis = links.read(path, source.link == MOVING)
        if not visuals:
            raise ArgumentError(f"URDF {path} has no link that is {source.link} and seen")
    scale = read_annotation(Path(folder) / OBJECTS / source.annotation)["scale"]
    bodies, colours = [], []
    for visual in visuals:
        for geometry in geometries(visual.path):
            vertices = scale * apply(visual.root_from_mesh, visual.scale * geometry.vertices)
            bodies.append(trimesh.Trimesh(vertices, geometry.faces, process=False))
            colours.append(face_colours(geometry, visual.path.suffix.lower() in LINEAR_FORMATS))
    return Shape(tuple(bodies), tuple(colours), axis)


def _hinge_alignment(shape: Shape, builtin: Asset) -> Matrix:
    """Rotation about z that aligns the hinge axis with that of the built-in asset."""
    if shape.axis is None or builtin.hinge is None:
        return np.eye(4)
    (ax, ay), (bx, by) = shape.axis.direction[:2], builtin.hinge.object_from_hinge[:2, 1]
    return transform((0, 0, 0), Rotation.from_euler("z", np.arctan2(ax * by - ay * bx, ax * bx + ay * by)))


def _collision_meshes(bodies: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """Convex pieces of the visual meshes. The release has convex hulls for some, which no gripper enters."""
    pieces = []
    for body in bodies:
        # Merge vertices that the file duplicates for shading.
        welded = trimesh.Trimesh(body.vertices, body.faces, process=True)
        shells = welded.split(only_watertight=False, repair=False)
        closed = 0 < len(shells) <= MAX_SHELLS and all(shell.is_watertight for shell in shells)
        pieces += [piece for shell in (shells if closed else [welded]) for piece in convex_pieces(shell)]
    return pieces


def _check_size(path: Path, scale: NDArray[np.float64], asset: Asset, builtin: Asset) -> None:
    sides = [float(np.ptp(item.bounds_m, axis=0).max()) for item in (asset, builtin)]
    if not SIZE_RATIOS[0] <= sides[0] / sides[1] <= SIZE_RATIOS[1]:
        raise ArgumentError(
            f"{path}: with its scale {scale.tolist()} the thing is {sides[0]:.3g} m long, and ours "
            f"{sides[1]:.3g} m; expected {SIZE_RATIOS[0]:g} to {SIZE_RATIOS[1]:g} times as much: "
            "scale is three numbers, metres for one unit of the mesh"
        )


def _annotated_pose(
    path: Path,
    annotation: Mapping[str, Any],
    source: Sequence[Any] | None,
    kind: str,
    asset_from_actor: Matrix,
) -> Matrix | None:
    """object_from_tcp of an annotated point; None for a point without an entry in released.yaml."""
    if source is None:
        return None
    key, index = source
    poses = annotation.get(key)
    if not isinstance(poses, list) or len(poses) <= index:
        problem = f"has {len(poses)} of them" if isinstance(poses, list) else _keys_text(annotation)
        raise ArgumentError(f"annotation {path} lacks number {index} of {key}; {problem}")
    pose = _array(poses[index])
    if pose.shape != (4, 4) or abs(np.linalg.det(pose[:3, :3]) - 1) > 0.01:
        raise ArgumentError(f"annotation {path}: number {index} of {key} is no pose; expected 4x4 numbers")
    pose[:3, 3] *= annotation["scale"]
    asset_from_hand = asset_from_actor @ pose @ HAND_ROTATION
    if kind in ("place", "drop"):
        return transform(asset_from_hand[:3, 3])
    return from_axes(asset_from_hand[:3, 3], z=asset_from_hand[:3, 0], y=asset_from_hand[:3, 1])


def _replaced_point(
    point: InteractionPoint, pose: Matrix | None, asset: Asset, builtin: Asset
) -> InteractionPoint:
    """A built-in point at its annotated pose, or else at the same relative place in the bounds."""
    if pose is not None:
        return replace(point, object_from_tcp=pose, around=1)
    (low, high), (builtin_low, builtin_high) = asset.bounds_m, builtin.bounds_m
    pose = point.object_from_tcp.copy()
    pose[:3, 3] = low + (pose[:3, 3] - builtin_low) / (builtin_high - builtin_low) * (high - low)
    return replace(point, object_from_tcp=pose)


def _with_grasp_width(path: Path, name: str, point: InteractionPoint, asset: Asset) -> InteractionPoint:
    """A grasp point with the width of the object between the fingers; other points are unchanged."""
    if point.kind != "grasp":
        return point
    tcp_from_object = inverse(point.object_from_tcp)
    offsets_m = (-PAD_HALF_WIDTH_M, 0.0, PAD_HALF_WIDTH_M)
    offsets = [(x, z) for x in offsets_m for z in offsets_m]
    sections = [_line_through_hull(hull, tcp_from_object, x, z) for hull in asset.hulls for x, z in offsets]
    ends = [section for section in sections if section is not None]
    if not ends:
        raise ArgumentError(f"annotation {path}: there is nothing to grasp at {name!r}; is its scale right?")
    width_m = 2 * float(np.abs(ends).max())
    if width_m > MAX_OPENING_M:
        raise ArgumentError(
            f"annotation {path}: at {name!r} the fingers would be {width_m:.3g} m apart; they open to "
            f"{MAX_OPENING_M:g} m: is its scale right?"
        )
    return replace(point, width_m=width_m)


def _line_through_hull(
    hull: trimesh.Trimesh, tcp_from_object: Matrix, x: float, z: float
) -> list[float] | None:
    """[begin, end] in y of a line along the TCP's y axis within a convex hull; None where it misses."""
    normals = hull.face_normals @ tcp_from_object[:3, :3].T
    corners = apply(tcp_from_object, hull.triangles[:, 0])
    distances = np.einsum("fk,fk->f", normals, corners - [x, 0.0, z])
    along = normals[:, 1]
    if (distances[np.abs(along) < 1e-9] < 0).any():
        return None
    ahead, behind = along > 1e-9, along < -1e-9
    ends = [(distances[behind] / along[behind]).max(), (distances[ahead] / along[ahead]).min()]
    return ends if ends[0] < ends[1] else None


def _keys_text(annotation: Mapping[str, Any]) -> str:
    return f"its keys are {', '.join(printable(key, 40) for key in [*annotation][:8]) or 'none'}"


def _array(value: object) -> NDArray[np.float64]:
    """A finite array of numbers; empty for any other value."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        return np.empty(0)
    return array if np.isfinite(array).all() else np.empty(0)
