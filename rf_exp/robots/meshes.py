"""The Panda's visual meshes with few triangles, made once and kept in a cache folder.

The meshes that ManiSkill ships have 135 thousand triangles an arm, which makes software rendering
six times as slow as it need be at 320x240. Quadric decimation (fast-simplification) keeps about 8
thousand; the colours stay, as does the collision geometry.
"""

import hashlib
import os
import shutil
from functools import cache
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import fast_simplification
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh.visual import TextureVisuals

from rf_exp.artifacts import whole
from rf_exp.errors import StageError
from rf_exp.robots.panda import description_folder
from rf_exp.transforms import Matrix, apply, transform

URDF = "panda_v2.urdf"
KEPT = 0.058  # share of the triangles that stays
FEWEST = 60  # a piece with fewer triangles than this is left alone
CARE = 3  # aggressiveness, 0 to 10; at the default of 7 white shells break through black ones
SMOOTH_RAD = np.deg2rad(20)  # edges sharper than this stay visible
REMEDY = "set XDG_CACHE_HOME to a writable folder"
LAYOUT = 2  # raise when the way of making the files changes

LinkMesh = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]


def cache_folder() -> Path:
    """Where the light meshes of the installed ManiSkill live; its name depends on all inputs.

    Raises StageError for a user without a home.
    """
    folder = description_folder()
    digest = hashlib.sha256(repr((KEPT, FEWEST, CARE, float(SMOOTH_RAD), LAYOUT, str(folder))).encode())
    for path in [folder / URDF, *sorted((folder / "franka_description/meshes/visual").glob("*.glb"))]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError as error:
        raise StageError(f"there is no place for the mesh cache: {error}; {REMEDY}") from error
    return Path(home) / "rf_exp" / digest.hexdigest()[:16]


def is_made(folder: Path) -> bool:
    """Whether the light meshes are in a cache folder, and may be read."""
    return os.access(folder / URDF, os.R_OK)


@cache
def light_urdf() -> Path:
    """The path of a URDF with light visuals and the original collision meshes, made when missing.

    Raises StageError when the cache folder cannot be written.
    """
    target = cache_folder()
    if not is_made(target):
        try:
            with whole(target) as draft:
                draft.mkdir()
                _make(draft, target)
        except OSError as error:
            # Of several processes that make it the first wins, the others find it complete.
            if not is_made(target):
                raise StageError(
                    f"cannot write the mesh cache {target}: {error.strerror or error}; {REMEDY}"
                ) from error
    return target / URDF


def light_meshes() -> dict[str, LinkMesh]:
    """Link -> vertices (V, 3) in metres in the frame of the link, faces (F, 3), linear RGB (V, 3)."""
    meshes: dict[str, LinkMesh] = {}
    for link in ElementTree.parse(light_urdf()).getroot().findall("link"):
        for visual in link.findall("visual"):
            pieces = _pieces(Path(_mesh(visual).attrib["filename"]))
            colours = [
                np.tile(_material(piece).baseColorFactor[:3] / 255, (len(piece.vertices), 1))
                for piece in pieces
            ]
            mesh = cast(trimesh.Trimesh, trimesh.util.concatenate(pieces))
            vertices = apply(_origin(visual), np.asarray(mesh.vertices))
            meshes[link.attrib["name"]] = (vertices, np.asarray(mesh.faces), np.concatenate(colours))
    return meshes


def _make(folder: Path, final: Path) -> None:
    """Write the light GLB files and the URDF that points to them once `folder` is called `final`."""
    source = description_folder()
    tree = ElementTree.parse(source / URDF)
    for visual in tree.getroot().iter("visual"):
        element = _mesh(visual)
        heavy = source / element.attrib["filename"]
        if not (folder / heavy.name).exists():
            scene = trimesh.Scene([_lighter(piece) for piece in _pieces(heavy)])
            scene.export(folder / heavy.name, include_normals=True)
        element.set("filename", str(final / heavy.name))
    for collision in tree.getroot().iter("collision"):
        if (element := collision.find("geometry/mesh")) is not None:
            element.set("filename", str(source / element.attrib["filename"]))
    tree.write(folder / URDF)
    # SAPIEN reads the pairs of links that may overlap from the file of the same name beside the URDF.
    shutil.copyfile((source / URDF).with_suffix(".srdf"), (folder / URDF).with_suffix(".srdf"))


def _pieces(path: Path) -> list[trimesh.Trimesh]:
    """The pieces of a GLB, one a material, in the frame of the file."""
    scene = cast(trimesh.Scene, trimesh.load(path, force="scene"))
    return [cast(trimesh.Trimesh, mesh) for mesh in scene.dump()]


def _material(piece: trimesh.Trimesh) -> Any:
    """The PBR material that a GLB gives each of its pieces."""
    return cast(TextureVisuals, piece.visual).material


def _lighter(piece: trimesh.Trimesh) -> trimesh.Trimesh:
    """The piece with fewer triangles, the same material and shading that is smooth where it was."""
    welded = trimesh.Trimesh(piece.vertices, piece.faces, process=True)
    welded.merge_vertices(merge_norm=True, merge_tex=True, digits_vertex=6)
    target = max(FEWEST, round(KEPT * len(piece.faces)))
    if target < len(welded.faces):
        vertices, faces, *_ = fast_simplification.simplify(
            np.asarray(welded.vertices), np.asarray(welded.faces), target_count=target, agg=CARE
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


def _mesh(visual: ElementTree.Element) -> ElementTree.Element:
    element = visual.find("geometry/mesh")
    assert element is not None, "every visual of the Panda is a mesh"
    return element


def _origin(visual: ElementTree.Element) -> Matrix:
    """The (4, 4) pose of a visual in its link; URDF angles are roll, pitch, yaw about fixed axes."""
    origin = visual.find("origin")
    if origin is None:
        return transform()
    xyz = [float(value) for value in origin.attrib["xyz"].split()]
    rpy = [float(value) for value in origin.attrib["rpy"].split()]
    return transform(xyz, Rotation.from_euler("xyz", rpy))
