"""Simplified visual meshes of a robot, made once and kept in a cache folder.

The Panda's meshes in ManiSkill have 135 thousand triangles an arm, which makes software rendering at 320x240
six times as slow as with simplified ones. Quadric decimation (fast-simplification) keeps about 8 thousand;
colours and collision geometry are unchanged, and so are meshes other than GLB files.
"""

import hashlib
import os
import shutil
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from xml.etree import ElementTree

import fast_simplification
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals

from rf_exp.robots.mounted import build_cached, cache_home
from rf_exp.robots.urdf import placement, root_of, shape
from rf_exp.transforms import apply

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

KEPT_SHARE = 0.058  # share of the triangles that is kept
MIN_TRIANGLES = 60  # no piece is reduced below this number of triangles
AGGRESSIVENESS = 3  # of the simplification, 0 to 10; at the default of 7 white shells show through black ones
SMOOTH_RAD = np.deg2rad(20)  # sharper edges are not shaded smooth
GLB = ".glb"
GREY = (0.5, 0.5, 0.5)  # linear RGB of visuals without a colour
LAYOUT = 2  # raise when the way of making the files changes

LinkMesh = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]


def cache_folder(robot: "Robot") -> Path:
    """The folder of a robot's simplified meshes; its name depends on all inputs.

    Raises StageError for a user without a home folder.
    """
    urdf = robot.urdf_path
    digest = hashlib.sha256(
        repr(
            (KEPT_SHARE, MIN_TRIANGLES, AGGRESSIVENESS, float(SMOOTH_RAD), LAYOUT, str(urdf.parent))
        ).encode()
    )
    visuals = {mesh.attrib["filename"] for mesh in root_of(robot).iterfind("link/visual/geometry/mesh")}
    for path in [urdf, *sorted(urdf.parent / name for name in visuals if name.endswith(GLB))]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return cache_home() / digest.hexdigest()[:16]


def has_simplified_meshes(robot: "Robot", folder: Path) -> bool:
    """Whether a cache folder has the simplified meshes and they are readable."""
    return os.access(folder / robot.urdf_path.name, os.R_OK)


@cache
def simplified_urdf(robot: "Robot") -> Path:
    """The path of a URDF with simplified visual and original collision meshes, made when missing.

    Raises StageError when the cache folder cannot be written.
    """
    folder = cache_folder(robot)
    make = partial(_write_simplified, robot, final=folder)
    return build_cached(folder / robot.urdf_path.name, f"mesh cache {folder}", make)


@cache
def simplified_meshes(robot: "Robot") -> dict[str, LinkMesh]:
    """Link -> vertices (V, 3) in metres in the frame of the link, faces (F, 3), linear RGB (V, 3).

    Only for links with visuals. Visuals other than GLB meshes are grey.
    """
    meshes: dict[str, LinkMesh] = {}
    for link in ElementTree.parse(simplified_urdf(robot)).getroot().findall("link"):
        parts = [_visual_mesh(visual, robot) for visual in link.findall("visual")]
        if not parts:
            continue
        vertices, faces, colours = zip(*parts, strict=True)
        firsts = np.cumsum([0, *map(len, vertices[:-1])])
        shifted = [triangles + first for triangles, first in zip(faces, firsts, strict=True)]
        meshes[link.attrib["name"]] = (
            np.concatenate(vertices),
            np.concatenate(shifted),
            np.concatenate(colours),
        )
    return meshes


def _visual_mesh(visual: ElementTree.Element, robot: "Robot") -> LinkMesh:
    """The triangles of a visual, in the frame of its link."""
    mesh = visual.find("geometry/mesh")
    if mesh is not None and mesh.attrib["filename"].endswith(GLB):
        pieces = _pieces(Path(mesh.attrib["filename"]))
        factors = [_material(piece).baseColorFactor for piece in pieces]  # None is white in GLB
        colours = [(1.0, 1.0, 1.0) if factor is None else factor[:3] / 255 for factor in factors]
    else:
        pieces = [shape(visual, robot.urdf_path.parent, robot.name)]
        colours = [GREY]
    vertex_colours = [
        np.tile(colour, (len(piece.vertices), 1)) for colour, piece in zip(colours, pieces, strict=True)
    ]
    combined = cast(trimesh.Trimesh, trimesh.util.concatenate(pieces))
    vertices = apply(placement(visual), np.asarray(combined.vertices))
    return vertices, np.asarray(combined.faces), np.concatenate(vertex_colours)


def _write_simplified(robot: "Robot", folder: Path, final: Path) -> None:
    """Writes simplified GLB files and a URDF whose paths are valid once `folder` is renamed to `final`."""
    urdf = robot.urdf_path
    tree = ElementTree.parse(urdf)
    for element in tree.getroot().iterfind("link/visual/geometry/mesh"):
        source = urdf.parent / element.attrib["filename"]
        is_glb = source.suffix == GLB
        if is_glb and not (folder / source.name).exists():
            scene = trimesh.Scene([_simplified(piece) for piece in _pieces(source)])
            scene.export(folder / source.name, include_normals=True)
        element.set("filename", str(final / source.name if is_glb else source))
    for element in tree.getroot().iterfind("link/collision/geometry/mesh"):
        element.set("filename", str(urdf.parent / element.attrib["filename"]))
    tree.write(folder / urdf.name)
    # SAPIEN reads the excused pairs of links from the SRDF of the same name beside the URDF.
    _write_srdf(robot, (folder / urdf.name).with_suffix(".srdf"))


def _write_srdf(robot: "Robot", path: Path) -> None:
    """Copies the SRDF of the robot; without one, writes one with the pairs not in `self_pairs`."""
    source = robot.urdf_path.with_suffix(".srdf")
    if source.exists():
        shutil.copyfile(source, path)
        return
    root, self_pairs = ElementTree.Element("robot", name=robot.name), set(robot.self_pairs)
    for i, j in combinations(range(len(robot.links)), 2):
        if (i, j) not in self_pairs:
            pair = {"link1": robot.links[i], "link2": robot.links[j], "reason": "Adjacent"}
            ElementTree.SubElement(root, "disable_collisions", pair)
    ElementTree.ElementTree(root).write(path)


def _pieces(path: Path) -> list[trimesh.Trimesh]:
    """The pieces of a GLB, one per material, in the frame of the file."""
    scene = cast(trimesh.Scene, trimesh.load(path, force="scene"))
    return [cast(trimesh.Trimesh, mesh) for mesh in scene.dump()]


def _material(piece: trimesh.Trimesh) -> Any:
    return cast(TextureVisuals, piece.visual).material


def _simplified(piece: trimesh.Trimesh) -> trimesh.Trimesh:
    """The piece with fewer triangles and the same material, its edges up to `SMOOTH_RAD` shaded smooth."""
    welded = trimesh.Trimesh(piece.vertices, piece.faces, process=True)
    welded.merge_vertices(merge_norm=True, merge_tex=True, digits_vertex=6)
    target = max(MIN_TRIANGLES, round(KEPT_SHARE * len(piece.faces)))
    if target < len(welded.faces):
        vertices, faces, *_ = fast_simplification.simplify(
            np.asarray(welded.vertices), np.asarray(welded.faces), target_count=target, agg=AGGRESSIVENESS
        )
        welded = trimesh.Trimesh(vertices, faces, process=True)
    shaded = trimesh.graph.smooth_shade(welded, angle=SMOOTH_RAD, facet_minarea=None)
    return trimesh.Trimesh(
        shaded.vertices,
        shaded.faces,
        vertex_normals=shaded.vertex_normals,
        visual=TextureVisuals(material=_material(piece)),
        process=False,
    )
