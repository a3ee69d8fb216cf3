"""Builds assets as ManiSkill actors: convex collision pieces, and one render mesh for each finish."""

from dataclasses import dataclass
from itertools import groupby
from typing import Any, cast

import numpy as np
import sapien
import trimesh
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.building.actor_builder import ActorBuilder
from mani_skill.utils.structs.actor import Actor
from numpy.typing import NDArray
from sapien import physx

from rf_exp.tasks.assets import Asset, Colour, Part
from rf_exp.transforms import Matrix, quaternion

SMOOTH_RAD = np.deg2rad(30)  # edges sharper than this are seen as edges
UNTINTED = np.ones(3)
PATCH_RADIUS_M = 0.02  # torsional friction of a contact, as of a soft surface


def sapien_pose(matrix: Matrix) -> sapien.Pose:
    """SAPIEN's pose of a (4, 4) matrix."""
    return sapien.Pose(matrix[:3, 3].tolist(), quaternion(matrix).tolist())


@dataclass(frozen=True)
class Surface:
    """Triangles of one finish, shaded, in the frame of their asset."""

    vertices: NDArray[np.float32]  # (V, 3) metres
    faces: NDArray[np.uint32]  # (F, 3)
    normals: NDArray[np.float32]  # (V, 3)
    colour: Colour
    roughness: float
    metallic: float

    def shape(self, tint: NDArray[np.float64]) -> sapien.render.RenderShapeTriangleMesh:
        """A new render shape, its colour times `tint` (3,); needs a renderer."""
        material = sapien.render.RenderMaterial()
        material.base_color = [*np.clip(self.colour * tint, 0.0, 1.0).tolist(), 1.0]
        material.roughness = self.roughness
        material.metallic = self.metallic
        uvs = np.zeros((len(self.vertices), 2), np.float32)
        return sapien.render.RenderShapeTriangleMesh(self.vertices, self.faces, self.normals, uvs, material)


def surfaces(asset: Asset) -> tuple[Surface, ...]:
    """The render meshes of an asset, one for each finish. Takes milliseconds: make them once."""

    def finish(part: Part) -> tuple[Colour, float, float]:
        return part.colour, part.roughness, part.metallic

    made = []
    for key, group in groupby(sorted(filter(_seen, asset.parts), key=finish), key=finish):
        shaded = [trimesh.graph.smooth_shade(part.mesh, angle=SMOOTH_RAD) for part in group]
        mesh = cast(trimesh.Trimesh, trimesh.util.concatenate(shaded))
        made.append(
            Surface(
                np.asarray(mesh.vertices, np.float32),
                np.asarray(mesh.faces, np.uint32),
                np.asarray(mesh.vertex_normals, np.float32),
                *key,
            )
        )
    return tuple(made)


def _seen(part: Part) -> bool:
    return part.seen


class AssetBuilder(ActorBuilder):
    """ManiSkill's actor builder, fed with an Asset instead of files."""

    def __init__(
        self, asset: Asset, seen: tuple[Surface, ...], tint: NDArray[np.float64], mass_kg: float
    ) -> None:
        super().__init__()
        self.asset, self.seen, self.tint, self.mass_kg = asset, seen, tint, mass_kg
        self.physx_body_type = "static" if asset.static or asset.ghost else "dynamic"

    def build_physx_component(self, link_parent: object = None) -> physx.PhysxRigidBaseComponent:
        static = self.physx_body_type == "static"
        body = physx.PhysxRigidStaticComponent() if static else physx.PhysxRigidDynamicComponent()
        material = physx.PhysxMaterial(self.asset.friction, self.asset.friction, 0.0)
        volume_m3 = sum(hull.volume for hull in self.asset.hulls)
        for hull in self.asset.hulls:
            shape = physx.PhysxCollisionShapeConvexMesh(
                vertices=np.asarray(hull.vertices, np.float32), scale=[1.0, 1.0, 1.0], material=material
            )
            shape.set_density(self.mass_kg / volume_m3)
            shape.set_patch_radius(PATCH_RADIUS_M)
            shape.set_min_patch_radius(PATCH_RADIUS_M)
            body.attach(shape)
        body.name = self.name
        return body

    def build_entity(self) -> sapien.Entity:
        entity = sapien.Entity()
        if self.scene.can_render():
            body = sapien.render.RenderBodyComponent()
            for surface in self.seen:
                body.attach(surface.shape(self.tint))
            entity.add_component(body)
        entity.add_component(self.build_physx_component())
        entity.name = self.name
        return entity


def build(
    scene: ManiSkillScene,
    name: str,
    asset: Asset,
    seen: tuple[Surface, ...],
    world_from_object: Matrix,
    tint: NDArray[np.float64] = UNTINTED,
    mass_kg: float | None = None,
) -> Actor:
    """Put an asset with its surfaces into the scene under a name, its colours times `tint` (3,).

    Without `mass_kg` it weighs what the asset says.
    """
    builder: Any = AssetBuilder(asset, seen, tint, asset.mass_kg if mass_kg is None else mass_kg)
    builder.set_scene(scene)
    builder.initial_pose = sapien_pose(world_from_object)
    return builder.build(name)
