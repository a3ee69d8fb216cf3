"""Collision shapes of PhysX as convex meshes, for scenes that somebody else has built."""

from collections.abc import Iterator

import numpy as np
import trimesh
from sapien import physx
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets
from rf_exp.transforms import transform

ROUND_SECTIONS = 24  # of a cylinder; what is round is held by its polyhedron
ALONG_X = transform(rotation=Rotation.from_euler("y", np.pi / 2))  # from trimesh's axis, z, to PhysX's


def solids(body: physx.PhysxRigidBaseComponent, what: str) -> tuple[trimesh.Trimesh, ...]:
    """Convex meshes in the frame of the body, metres, which together hold its collision shapes.

    Triangle meshes are decomposed, in seconds. Planes have no extent and are left out. Raises ArgumentError
    for a mesh that is not closed, and for a kind of shape that is not known; `what` names the body in it.
    """
    found = []
    for shape in body.collision_shapes:
        if isinstance(shape, physx.PhysxCollisionShapePlane):
            continue
        body_from_shape = shape.local_pose.to_transformation_matrix().astype(float)
        found += [mesh.apply_transform(body_from_shape) for mesh in _meshes(shape, what)]
    return tuple(found)


def _meshes(shape: physx.PhysxCollisionShape, what: str) -> Iterator[trimesh.Trimesh]:
    """In the frame of the shape."""
    if isinstance(shape, physx.PhysxCollisionShapeBox):
        yield trimesh.creation.box(2 * np.asarray(shape.half_size, float))
    elif isinstance(shape, physx.PhysxCollisionShapeSphere):
        yield _ball(shape.radius)
    elif isinstance(shape, physx.PhysxCollisionShapeCylinder):
        around = shape.radius / np.cos(np.pi / ROUND_SECTIONS)
        yield trimesh.creation.cylinder(around, 2 * shape.half_length, ROUND_SECTIONS, transform=ALONG_X)
    elif isinstance(shape, physx.PhysxCollisionShapeCapsule):
        corners = _ball(shape.radius).vertices
        ends = [corners + np.array((side * shape.half_length, 0.0, 0.0)) for side in (-1, 1)]
        yield trimesh.convex.convex_hull(np.concatenate(ends))
    elif isinstance(shape, physx.PhysxCollisionShapeConvexMesh):
        yield trimesh.convex.convex_hull(np.asarray(shape.vertices, float) * shape.scale)
    elif isinstance(shape, physx.PhysxCollisionShapeTriangleMesh):
        yield from _decomposed(shape, what)
    else:
        raise ArgumentError(f"{what} has a collision shape of type {type(shape).__name__}, which is not read")


def _ball(radius_m: float) -> trimesh.Trimesh:
    """A polyhedron that holds a sphere."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    inner = float(np.einsum("fi,fi->f", ball.triangles_center, ball.face_normals).min())
    return ball.apply_scale(radius_m / inner)


def _decomposed(shape: physx.PhysxCollisionShapeTriangleMesh, what: str) -> Iterator[trimesh.Trimesh]:
    mesh = trimesh.Trimesh(np.asarray(shape.vertices, float) * shape.scale, shape.triangles, process=True)
    for shell in mesh.split(only_watertight=False, repair=False):
        shell.fix_normals()
        if not shell.is_watertight or shell.volume <= 0:
            raise ArgumentError(
                f"{what} has a triangle mesh that is not closed, so it has no inside to be kept clear of; "
                "leave it out with `ignore`, or give its actor convex collision shapes"
            )
        yield from assets.convex_pieces(shell)
