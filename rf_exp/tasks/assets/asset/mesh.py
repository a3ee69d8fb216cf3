"""An asset made of a user's own mesh and its annotation: `asset: my_shoe.yaml` in a task.

Every closed shell of the mesh becomes convex solid parts, which nobody sees; the mesh itself, which
nothing touches, is what pictures show.
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals, uv_to_color

from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks import assets
from rf_exp.tasks.assets.asset import annotation
from rf_exp.tasks.assets.asset.annotation import Annotation
from rf_exp.tasks.assets.asset.base import Asset, Colour, InteractionPoint, Part, convex_pieces

FORMATS = (".glb", ".obj", ".ply", ".stl")
LINEAR = (".glb",)  # formats whose colours are linear, but for textures; elsewhere all is sRGB
GREY: Colour = (0.35, 0.35, 0.35)
COLOURS = 16  # more than these are made fewer
ON_TABLE_M = 0.001  # how far the lowest point may be from z = 0


def build(path: str) -> Asset:
    """The asset of an annotation file. A shell that is not convex takes a second or two to decompose.

    Raises ArgumentError for a file that is missing or wrong, a mesh that is not watertight, and one
    that does not stand on z = 0.
    """
    file = Path(path)
    said = annotation.read(file)
    try:
        return Asset(
            file.stem,
            parts=_parts(said, file.parent / said.mesh),
            points=_points(said),
            mass_kg=said.mass_kg,
            heaviest_kg=said.heaviest_kg,
            friction=said.friction,
            static=said.static,
        )
    except ArgumentError as error:
        raise ArgumentError(f"annotation {file}: {error}") from error


def _points(said: Annotation) -> dict[str, InteractionPoint]:
    points: dict[str, InteractionPoint] = {}
    if said.points_of is not None:
        if said.points_of not in assets.available():
            raise choices("asset in points_of", said.points_of, assets.available())
        points |= assets.load(said.points_of).points
    for name, point in said.points.items():
        try:
            points[name] = point.interaction_point()
        except ArgumentError as error:
            raise ArgumentError(f"point {name!r}: {error}") from error
    return points


def _parts(said: Annotation, path: Path) -> tuple[Part, ...]:
    """Convex solid parts that are not seen, and the surface in its colours, which is not solid."""
    parts = []
    for geometry in _geometries(path):
        colours = _face_colours(geometry, path.suffix.lower() in LINEAR)  # (F, 3)
        # Corners that a file keeps apart for its shading are one corner of the body.
        body = trimesh.Trimesh(geometry.vertices, geometry.faces, process=True)
        body.apply_scale(said.scale).apply_transform(said.frame.asset_from_mesh)
        solids = [piece for shell in _shells(body, path) for piece in convex_pieces(shell)]
        parts += [Part(piece, GREY, seen=False) for piece in solids]
        parts += _surface(body, colours if said.colour is None else np.tile(said.colour, (len(colours), 1)))
    lowest_m = min(part.mesh.bounds[0, 2] for part in parts if part.seen)
    if abs(lowest_m) > ON_TABLE_M:
        raise ArgumentError(
            f"the lowest point of {path.name} is at z = {lowest_m:.4f} m; expected 0: "
            f"add {-lowest_m:.4f} to the third number of frame.position_m"
        )
    return tuple(parts)


def _geometries(path: Path) -> list[trimesh.Trimesh]:
    """The meshes of a file, where its scene puts them, in units of the file."""
    if path.suffix.lower() not in FORMATS:
        raise choices("mesh format", path.suffix, FORMATS)
    if not path.is_file():
        raise ArgumentError(f"there is no mesh file {path}")
    try:
        dumped = trimesh.load_scene(path).dump()
    except Exception as error:  # every format has errors of its own
        raise ArgumentError(f"mesh {path} cannot be read: {error}") from error
    geometries = [mesh for mesh in dumped if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not geometries:
        raise ArgumentError(f"mesh {path} has no triangles")
    return geometries


def _shells(body: trimesh.Trimesh, path: Path) -> list[trimesh.Trimesh]:
    """The connected pieces of a mesh, each closed and with its outside out."""
    shells = list(body.split(only_watertight=False, repair=False))
    for shell in shells:
        shell.fix_normals()
        if not shell.is_watertight or shell.volume <= 0:
            bad = int((np.bincount(shell.edges_unique_inverse) != 2).sum())
            raise ArgumentError(
                f"mesh {path.name} is not watertight: in a piece of {len(shell.faces)} triangles {bad} edges "
                "do not have a triangle on either side; expected closed surfaces, with an inside"
            )
    return shells


def _face_colours(geometry: trimesh.Trimesh, linear: bool) -> NDArray[np.float64]:
    """(F, 3) linear RGB in [0, 1] of the triangles: their own, their material's, or their texture's."""
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


def _surface(body: trimesh.Trimesh, colours: NDArray[np.float64]) -> list[Part]:
    """One part that is only seen for each colour; similar ones share their mean where there are many."""
    keys, group = np.unique(colours, axis=0, return_inverse=True)
    if len(keys) > COLOURS:
        keys, group = np.unique(np.round(colours * 3), axis=0, return_inverse=True)  # 4 levels a channel
    parts = []
    for k in range(len(keys)):
        faces = np.flatnonzero(group.ravel() == k)
        red, green, blue = colours[faces].mean(axis=0).tolist()
        painted: Any = body.submesh([faces], append=True, repair=False)
        parts.append(Part(painted, (red, green, blue), solid=False))
    return parts
