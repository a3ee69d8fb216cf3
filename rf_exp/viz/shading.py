"""Normals and colours for the viewer, from plain triangles and linear light."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

CREASE_DEG = 40.0  # faces that meet at more than this keep a sharp edge


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
    one, other = (incidence @ incidence.T).nonzero()  # pairs of corners at one vertex
    smooth = np.einsum("ij,ij->i", units[face[one]], units[face[other]]) > np.cos(np.deg2rad(CREASE_DEG))
    normals = np.zeros((len(vertex), 3))
    np.add.at(normals, one[smooth], areas[face[other[smooth]]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    corners = np.column_stack([vertex, normals.round(3)])
    _, kept, indices = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    return vertex[kept].astype(np.int64), normals[kept], indices.reshape(-1, 3)
