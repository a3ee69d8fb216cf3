"""Collision shapes of PhysX become convex meshes that contain them closely."""

from pathlib import Path

import numpy as np
import pytest
import sapien
import trimesh
from sapien import physx

from rf_exp.errors import ArgumentError
from rf_exp.sim.third_party import solids

POSE = sapien.Pose([0.1, 0.2, 0.3], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # a quarter turn about z
BALL_M3 = 4 / 3 * np.pi * 0.02**3


def body_of(*shapes: physx.PhysxCollisionShape) -> physx.PhysxRigidBaseComponent:
    body = physx.PhysxRigidStaticComponent()
    for shape in shapes:
        shape.local_pose = POSE
        body.attach(shape)
    return body


def stl_file(mesh: trimesh.Trimesh, folder: Path) -> str:
    mesh.export(folder / "mesh.stl")
    return str(folder / "mesh.stl")


@pytest.mark.parametrize(
    ("shape", "size_m", "volume_m3"),
    [
        (
            lambda material: physx.PhysxCollisionShapeBox((0.01, 0.02, 0.03), material),
            (0.04, 0.02, 0.06),
            48e-6,
        ),
        (lambda material: physx.PhysxCollisionShapeSphere(0.02, material), (0.04, 0.04, 0.04), BALL_M3),
        (
            lambda material: physx.PhysxCollisionShapeCylinder(0.02, 0.05, material),
            (0.04, 0.1, 0.04),
            np.pi * 0.02**2 * 0.1,
        ),
        (
            lambda material: physx.PhysxCollisionShapeCapsule(0.02, 0.05, material),
            (0.04, 0.14, 0.04),
            np.pi * 0.02**2 * 0.1 + BALL_M3,
        ),
    ],
)
def test_a_shape_is_contained_in_a_mesh_of_its_size(
    shape, size_m: tuple[float, ...], volume_m3: float
) -> None:
    (mesh,) = solids(body_of(shape(physx.PhysxMaterial(1.0, 1.0, 0.0))), "it")
    assert mesh.is_convex and mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), POSE.p, atol=1e-6)
    assert np.ptp(mesh.bounds, axis=0) == pytest.approx(size_m, rel=0.05)
    assert np.all(np.ptp(mesh.bounds, axis=0) >= np.array(size_m) - 1e-6)
    assert volume_m3 * (1 - 1e-6) <= mesh.volume <= 1.15 * volume_m3


def test_meshes_keep_their_shape(tmp_path: Path) -> None:
    """A ring keeps its hole."""
    ring, material = trimesh.creation.annulus(0.05, 0.07, 0.02, sections=12), physx.PhysxMaterial(1, 1, 0)
    file = stl_file(ring, tmp_path)
    convex = body_of(physx.PhysxCollisionShapeConvexMesh(file, (1, 1, 2), material))
    (hull,) = solids(convex, "it")
    assert np.ptp(hull.bounds, axis=0) == pytest.approx((0.14, 0.14, 0.04), rel=0.04)
    concave = body_of(physx.PhysxCollisionShapeTriangleMesh(file, (1, 1, 1), material))
    pieces = solids(concave, "it")
    assert all(mesh.is_convex for mesh in pieces)
    assert ring.volume * 0.99 < sum(mesh.volume for mesh in pieces) < 1.2 * ring.volume


def test_an_open_mesh_is_refused(tmp_path: Path) -> None:
    lid = trimesh.creation.box((0.2, 0.2, 0.02)).submesh([range(10)], append=True)
    assert isinstance(lid, trimesh.Trimesh)
    file = stl_file(lid, tmp_path)
    open_box = body_of(physx.PhysxCollisionShapeTriangleMesh(file, (1, 1, 1), physx.PhysxMaterial(1, 1, 0)))
    with pytest.raises(ArgumentError, match="lid has a triangle mesh that is not closed"):
        solids(open_box, "lid")


def test_planes_have_no_extent() -> None:
    assert solids(body_of(physx.PhysxCollisionShapePlane(physx.PhysxMaterial(1, 1, 0))), "ground") == ()
