"""Assets of the authors' release in place of built-in ones: their meshes and annotated points.

    objects/<name>/*.obj, *.glb, *.urdf
    objects/<name>/model_data.json  scale (3); contact_points_pose, functional_matrix, target_pose: 4x4 each

Translations of these poses are in units of the mesh. The gripper approaches along the x axis of `pose @ HAND`
and closes along y. Mass and friction are in none of the files: both are those of the built-in asset.
`released.yaml` maps built-in assets to files.
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
from rf_exp.tasks.assets.asset.mesh import GREY, LINEAR, face_colours, geometries, surface
from rf_exp.tasks.assets.asset.released import MOVING, released
from rf_exp.texts import printable
from rf_exp.transforms import Matrix, apply, from_axes, inverse, transform

OBJECTS = "objects"  # below the release's folder `assets`
HAND = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # by which poses are turned
WIDEST_M = 0.08  # between open fingers
SIZES = (0.5, 2.0)  # bounds of the longest side's ratio to that of the built-in asset
MOST_SHELLS = 256  # most shells that are decomposed one by one
PAD_M = 0.009  # half the width of a finger pad


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
    ours, source = assets.load(like, options), released()[like]
    notes = Path(folder) / OBJECTS / source.annotation
    said, shape = read_annotation(notes), shape_of(folder, like)
    stands = transform((0, 0, 0), Rotation.from_quat(source.standing_wxyz, scalar_first=True))
    if source.hinge_of is not None:
        stands = _turned(shape, assets.load(source.hinge_of)) @ stands
    turned = [body.copy().apply_transform(stands) for body in shape.bodies]
    asset_from_actor = transform((0, 0, -min(float(body.bounds[0, 2]) for body in turned))) @ stands
    bodies = [body.copy().apply_transform(asset_from_actor) for body in shape.bodies]
    parts = [Part(piece, GREY, seen=False) for piece in _solids(bodies)]
    for body, colours in zip(bodies, shape.colours, strict=True):
        parts += surface(body, colours)
    made = replace(ours, name=f"{like}_of_release", parts=tuple(parts))
    _check_size(notes, said["scale"], made, ours)
    points = {}
    for name, point in ours.points.items():
        pose = _annotated(notes, said, source.points.get(name), point.kind, asset_from_actor)
        points[name] = _as_wide(notes, name, _instead(point, pose, made, ours), made)
    hinge = ours.hinge
    if hinge is not None:
        if shape.axis is None:
            raise ArgumentError(
                f"{Path(folder) / OBJECTS / source.mesh} has no link that turns, as {like} does"
            )
        along = asset_from_actor[:3, :3] @ shape.axis.direction
        across = np.eye(3)[np.abs(along).argmin()]
        position = apply(asset_from_actor, np.array([shape.axis.position * said["scale"]]))[0]
        hinge = replace(hinge, object_from_hinge=from_axes(position, z=np.cross(across, along), y=along))
    return replace(made, points=points, hinge=hinge)


def read_annotation(path: Path) -> Mapping[str, Any]:
    """The annotation of a release asset, `scale` as an array (3,). Raises ArgumentError."""
    try:
        said: Any = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise ArgumentError(f"there is no {path}; assets_folder is the release's folder `assets`") from error
    except (OSError, ValueError, RecursionError) as error:
        raise ArgumentError(f"annotation {path} cannot be read: {printable(error)}") from error
    said = said if isinstance(said, dict) else {}
    scale = _array(said.get("scale"))
    if scale.shape != (3,) or not (scale > 0).all():
        raise ArgumentError(
            f"annotation {path} has no scale of three numbers above 0; {_keys(said)}, and expected are "
            "scale, contact_points_pose, functional_matrix and target_pose"
        )
    return {**said, "scale": scale}


@cache
def shape_of(folder: str, like: str) -> Shape:
    source = released()[like]
    path, axis = Path(folder) / OBJECTS / source.mesh, None
    found = [links.Visual(path, np.eye(4), np.ones(3))]
    if source.link is not None:
        found, axis = links.read(path, source.link == MOVING)
        if not found:
            raise ArgumentError(f"URDF {path} has no link that is {source.link} and seen")
    scale = read_annotation(Path(folder) / OBJECTS / source.annotation)["scale"]
    bodies, colours = [], []
    for visual in found:
        for geometry in geometries(visual.path):
            vertices = scale * apply(visual.root_from_mesh, visual.scale * geometry.vertices)
            bodies.append(trimesh.Trimesh(vertices, geometry.faces, process=False))
            colours.append(face_colours(geometry, visual.path.suffix.lower() in LINEAR))
    return Shape(tuple(bodies), tuple(colours), axis)


def _turned(shape: Shape, ours: Asset) -> Matrix:
    """Rotation about z that aligns the hinge axis with that of the built-in asset."""
    if shape.axis is None or ours.hinge is None:
        return np.eye(4)
    (ax, ay), (bx, by) = shape.axis.direction[:2], ours.hinge.object_from_hinge[:2, 1]
    return transform((0, 0, 0), Rotation.from_euler("z", np.arctan2(ax * by - ay * bx, ax * bx + ay * by)))


def _solids(bodies: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """Convex pieces of the visual meshes. The release has convex hulls for some, which no gripper enters."""
    solids = []
    for body in bodies:
        # Merge vertices that the file duplicates for shading.
        welded = trimesh.Trimesh(body.vertices, body.faces, process=True)
        shells = welded.split(only_watertight=False, repair=False)
        closed = 0 < len(shells) <= MOST_SHELLS and all(shell.is_watertight for shell in shells)
        solids += [piece for shell in (shells if closed else [welded]) for piece in convex_pieces(shell)]
    return solids


def _check_size(path: Path, scale: NDArray[np.float64], made: Asset, ours: Asset) -> None:
    sides = [float(np.ptp(asset.bounds_m, axis=0).max()) for asset in (made, ours)]
    if not SIZES[0] <= sides[0] / sides[1] <= SIZES[1]:
        raise ArgumentError(
            f"{path}: with its scale {scale.tolist()} the thing is {sides[0]:.3g} m long, and ours "
            f"{sides[1]:.3g} m; expected {SIZES[0]:g} to {SIZES[1]:g} times as much: scale is three numbers, "
            "metres for one unit of the mesh"
        )


def _annotated(
    path: Path, said: Mapping[str, Any], where: Sequence[Any] | None, kind: str, asset_from_actor: Matrix
) -> Matrix | None:
    """object_from_tcp of an annotated point; None for a point without an entry in released.yaml."""
    if where is None:
        return None
    key, number = where
    listed = said.get(key)
    if not isinstance(listed, list) or len(listed) <= number:
        has = f"has {len(listed)} of them" if isinstance(listed, list) else _keys(said)
        raise ArgumentError(f"annotation {path} lacks number {number} of {key}; {has}")
    pose = _array(listed[number])
    if pose.shape != (4, 4) or abs(np.linalg.det(pose[:3, :3]) - 1) > 0.01:
        raise ArgumentError(f"annotation {path}: number {number} of {key} is no pose; expected 4x4 numbers")
    pose[:3, 3] *= said["scale"]
    found = asset_from_actor @ pose @ HAND
    if kind in ("place", "drop"):
        return transform(found[:3, 3])
    return from_axes(found[:3, 3], z=found[:3, 0], y=found[:3, 1])


def _instead(point: InteractionPoint, pose: Matrix | None, made: Asset, ours: Asset) -> InteractionPoint:
    """A built-in point at its annotated pose, or else at the same relative place in the bounds."""
    if pose is not None:
        return replace(point, object_from_tcp=pose, around=1)
    (low, high), (own_low, own_high) = made.bounds_m, ours.bounds_m
    pose = point.object_from_tcp.copy()
    pose[:3, 3] = low + (pose[:3, 3] - own_low) / (own_high - own_low) * (high - low)
    return replace(point, object_from_tcp=pose)


def _as_wide(path: Path, name: str, point: InteractionPoint, made: Asset) -> InteractionPoint:
    """A grasp point with the width of the object between the fingers; other points are unchanged."""
    if point.kind != "grasp":
        return point
    tcp_from_object = inverse(point.object_from_tcp)
    offsets = [(x, z) for x in (-PAD_M, 0.0, PAD_M) for z in (-PAD_M, 0.0, PAD_M)]
    crossed = [_crossed(hull, tcp_from_object, x, z) for hull in made.hulls for x, z in offsets]
    ends = [each for each in crossed if each is not None]
    if not ends:
        raise ArgumentError(f"annotation {path}: there is nothing to grasp at {name!r}; is its scale right?")
    width_m = 2 * float(np.abs(ends).max())
    if width_m > WIDEST_M:
        raise ArgumentError(
            f"annotation {path}: at {name!r} the fingers would be {width_m:.3g} m apart; they open to "
            f"{WIDEST_M:g} m: is its scale right?"
        )
    return replace(point, width_m=width_m)


def _crossed(hull: trimesh.Trimesh, tcp_from_object: Matrix, x: float, z: float) -> list[float] | None:
    """[begin, end] in y of a line along the TCP's y axis within a convex hull; None where it misses."""
    normals = hull.face_normals @ tcp_from_object[:3, :3].T
    corners = apply(tcp_from_object, hull.triangles[:, 0])
    left = np.einsum("fk,fk->f", normals, corners - [x, 0.0, z])
    along = normals[:, 1]
    if (left[np.abs(along) < 1e-9] < 0).any():
        return None
    ahead, behind = along > 1e-9, along < -1e-9
    ends = [(left[behind] / along[behind]).max(), (left[ahead] / along[ahead]).min()]
    return ends if ends[0] < ends[1] else None


def _keys(said: Mapping[str, Any]) -> str:
    return f"its keys are {', '.join(printable(each, 40) for each in [*said][:8]) or 'none'}"


def _array(value: object) -> NDArray[np.float64]:
    """A finite array of numbers; empty for any other value."""
    try:
        found = np.array(value, float)
    except (TypeError, ValueError):
        return np.empty(0)
    return found if np.isfinite(found).all() else np.empty(0)
