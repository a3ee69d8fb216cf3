"""Conversion of our values to rerun's, with vertex normals and sRGB colours of meshes."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun.components import MarkerShape
from scipy.sparse import csr_array

from rf_exp.errors import ArgumentError
from rf_exp.robots import Robot
from rf_exp.transforms import Matrix
from rf_exp.types import FINGERS, GRIPPER_CLOSED, GRIPPER_OPEN, CameraModel

CREASE_DEG = 40.0  # faces that meet at more than this keep a sharp edge
FRUSTUM_M = 0.07  # length of the camera frustums
PREDICTED_PX = 1.5  # size of the dots of predicted values


@dataclass(frozen=True)
class Mesh:
    """Triangles in the frame of their entity, metres.

    `colour`: linear RGB in [0, 1], (3,) for all or (V, 3) for each vertex.
    """

    vertices: NDArray[np.floating]  # (V, 3)
    faces: NDArray[np.integer]  # (F, 3) indices into vertices, counter-clockwise from outside
    colour: ArrayLike


def mesh3d(entity: str, mesh: Mesh) -> rr.Mesh3D:
    """The mesh for rerun. Raises ArgumentError naming the entity."""
    count = len(mesh.vertices)
    require_array(f"vertices of {entity!r}", mesh.vertices, (count, 3))
    require_array(f"faces of {entity!r}", mesh.faces, (len(mesh.faces), 3))
    tint = srgb(mesh.colour)
    if tint.shape not in ((3,), (count, 3)):
        found_shape = "x".join(map(str, tint.shape))
        raise ArgumentError(f"colour of {entity!r} has shape {found_shape}; expected 3 or {count}x3")
    vertices, normals, faces = creased(mesh.vertices, mesh.faces)
    return rr.Mesh3D(
        vertex_positions=mesh.vertices[vertices],
        triangle_indices=faces,
        vertex_normals=normals,
        vertex_colors=np.broadcast_to(tint, (count, 3))[vertices].astype(np.uint8),
    )


def srgb(linear: ArrayLike) -> NDArray[np.uint8]:
    """Linear RGB in [0, 1] to sRGB in 0..255 (IEC 61966-2-1)."""
    value = np.clip(np.asarray(linear, dtype=float), 0.0, 1.0)
    curved = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255 * curved).astype(np.uint8)


def creased(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """A mesh (V, 3), (F, 3) with normals: vertex indices (K,), unit normals (K, 3), faces (F, 3) into K.

    A vertex is doubled where its faces meet at more than `CREASE_DEG`. Without normals the viewer
    draws flat silhouettes, and with one normal for each vertex a box looks round.
    """
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    areas = np.cross(second - first, third - first)  # (F, 3) along the normal, twice the area long
    units = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-12)
    vertex, face = faces.ravel(), np.repeat(np.arange(len(faces)), 3)  # of each corner (3F,)
    incidence = csr_array((np.ones(len(vertex)), (np.arange(len(vertex)), vertex)))
    first_corner, second_corner = (incidence @ incidence.T).nonzero()  # pairs of corners at one vertex
    smooth = np.einsum("ij,ij->i", units[face[first_corner]], units[face[second_corner]]) > np.cos(
        np.deg2rad(CREASE_DEG)
    )
    normals = np.zeros((len(vertex), 3))
    np.add.at(normals, first_corner[smooth], areas[face[second_corner[smooth]]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    corners = np.column_stack([vertex, normals.round(3)])
    _, kept, indices = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    return vertex[kept].astype(np.int64), normals[kept], indices.reshape(-1, 3)


def require_array(name: str, value: object, shape: tuple[int, ...], dtype: np.dtype | None = None) -> None:
    """Raise ArgumentError naming `name` unless `value` is a finite array of that shape and type."""
    array = np.asarray(value)
    if array.shape != shape:
        found_shape = "x".join(map(str, array.shape)) or "of one number"
        raise ArgumentError(f"{name} has shape {found_shape}; expected {'x'.join(map(str, shape))}")
    if dtype is not None and array.dtype != dtype:
        raise ArgumentError(f"{name} is {array.dtype}; expected {dtype}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name} holds {array[~np.isfinite(array)][0]}; expected finite numbers")


def opening_mm(robot: Robot, target: NDArray[np.floating]) -> float:
    """Distance between the fingers for a commanded target (A,)."""
    open_mm = 1000.0 * FINGERS * robot.hand.open_m
    return open_mm * float(target[-1] - GRIPPER_CLOSED) / (GRIPPER_OPEN - GRIPPER_CLOSED)


def path_part(code: str) -> str:
    """Check code or a condition as part of an entity path, without characters that need escapes."""
    return re.sub(r"\W+", "-", code).strip("-")


def transform(pose: Matrix) -> rr.Transform3D:
    return rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def pinhole(camera: CameraModel) -> rr.Pinhole:
    return rr.Pinhole(
        image_from_camera=camera.intrinsics,
        width=camera.width_px,
        height=camera.height_px,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=FRUSTUM_M,
    )


def lines(colours: Iterable[tuple[int, ...]], names: list[str], width: int) -> rr.SeriesLines:
    """The style of curves."""
    return rr.SeriesLines(colors=list(colours), names=names, widths=[width] * len(names))


def dots(colours: Iterable[tuple[int, ...]], names: list[str]) -> rr.SeriesPoints:
    """The style of curves drawn as points only."""
    return rr.SeriesPoints(
        colors=list(colours),
        names=names,
        marker_sizes=[PREDICTED_PX] * len(names),
        markers=[MarkerShape.Circle] * len(names),
    )
