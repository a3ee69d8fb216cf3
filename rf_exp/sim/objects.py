"""ManiSkill actors of assets and of the table: convex collision pieces, and a render mesh per finish."""

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import groupby, product
from typing import Any, cast

import numpy as np
import sapien
import trimesh
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.building.actor_builder import ActorBuilder
from mani_skill.utils.structs.actor import Actor
from numpy.typing import NDArray
from sapien import physx

from rf_exp.sim.textures import SIZE_PX, pixels
from rf_exp.tasks import TABLE_CENTRE_M, TABLE_M
from rf_exp.tasks.assets import Asset, Colour, Hinge, Part
from rf_exp.transforms import Matrix, from_axes, planar, quaternion, transform
from rf_exp.types import DEFAULT_FINISH, Finish, Look, Texture

SMOOTH_RAD = np.deg2rad(30)  # sharper edges are not shaded smooth
UNTINTED = np.ones(3)
RIGID_SWING = 1e4, 1e2  # stiffness in N m/rad and damping in N m s/rad of a hinge about its other axes
PATCH_RADIUS_M = 0.02  # torsional friction of contacts, like that of a soft surface
WHITE: Colour = (1.0, 1.0, 1.0)
MIPMAPS = SIZE_PX.bit_length()  # down to one pixel, or distant repeating patterns would flicker
FLOOR_Z_M = -0.75
WALL_DISTANCE_M = 3.5  # from the centre of the room
WOOD, LEG, FLOOR, WALL = (0.50, 0.37, 0.25), (0.12, 0.12, 0.13), (0.30, 0.31, 0.32), (0.42, 0.48, 0.54)


def sapien_pose(matrix: Matrix) -> sapien.Pose:
    """SAPIEN's pose of a (4, 4) matrix."""
    return sapien.Pose(matrix[:3, 3].tolist(), quaternion(matrix).tolist())


def matrix_of(pose: Any) -> Matrix:
    """The (4, 4) matrix of a SAPIEN pose."""
    return pose.to_transformation_matrix().astype(float)


@dataclass(frozen=True)
class Surface:
    """Shaded triangle mesh of one finish, in the frame of its asset."""

    vertices: NDArray[np.float32]  # (V, 3) metres
    faces: NDArray[np.uint32]  # (F, 3)
    normals: NDArray[np.float32]  # (V, 3)
    colour: Colour
    roughness: float
    metallic: float
    texture: Texture | None = None  # multiplied by the colour

    def shape(self, tint: NDArray[np.float64]) -> sapien.render.RenderShapeTriangleMesh:
        """A new render shape, its colour times `tint` (3,); needs a renderer."""
        material = sapien.render.RenderMaterial()
        material.base_color = [*np.clip(self.colour * tint, 0.0, 1.0).tolist(), 1.0]
        material.roughness = self.roughness
        material.metallic = self.metallic
        if self.texture is None:
            mesh, uvs = self, np.zeros((len(self.vertices), 2), np.float32)
        else:
            mesh = self._unshared_vertices()
            uvs = mesh._box_projection_m() / np.float32(self.texture.tile_m)
            rgb = pixels(self.texture)
            rgba = np.concatenate([rgb, np.full_like(rgb[..., :1], 255)], axis=-1)
            material.base_color_texture = sapien.render.RenderTexture2D(
                rgba, "R8G8B8A8Unorm", mipmap_levels=MIPMAPS, srgb=True
            )
        return sapien.render.RenderShapeTriangleMesh(mesh.vertices, mesh.faces, mesh.normals, uvs, material)

    def _unshared_vertices(self) -> "Surface":
        """The same triangles without shared vertices: neighbours may be textured along different axes."""
        corners = self.faces.ravel()
        faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        return replace(self, vertices=self.vertices[corners], faces=faces, normals=self.normals[corners])

    def _box_projection_m(self) -> NDArray[np.float32]:
        """(V, 2) metres along the two axes that each triangle faces least, after `_unshared_vertices`."""
        corners = self.vertices.reshape(-1, 3, 3)  # (F, corner, axis)
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        along = np.array([(1, 2), (0, 2), (0, 1)])[np.abs(areas).argmax(axis=1)]  # (F, 2)
        return np.take_along_axis(corners, along[:, None], axis=2).reshape(-1, 2)


def with_finish(visuals: tuple[Surface, ...], finish: Finish) -> tuple[Surface, ...]:
    """Surfaces with another finish: its colour on the lightest; the others keep their relative brightness."""
    lightest = max(max(surface.colour) for surface in visuals) or 1.0  # all surfaces black
    finished = []
    for surface in visuals:
        colour, shade = surface.colour, max(surface.colour) / lightest
        if (base_colour := finish.colour or (WHITE if finish.texture else None)) is not None:
            colour = (base_colour[0] * shade, base_colour[1] * shade, base_colour[2] * shade)
        roughness = surface.roughness if finish.roughness is None else finish.roughness
        finished.append(replace(surface, colour=colour, texture=finish.texture, roughness=roughness))
    return tuple(finished)


@lru_cache(maxsize=64)  # takes milliseconds
def surfaces(asset: Asset) -> tuple[Surface, ...]:
    """The render meshes of an asset, one per finish."""

    def finish(part: Part) -> tuple[Colour, float, float]:
        return part.colour, part.roughness, part.metallic

    visuals = []
    for key, group in groupby(sorted((part for part in asset.parts if part.visible), key=finish), key=finish):
        shaded = [trimesh.graph.smooth_shade(part.mesh, angle=SMOOTH_RAD) for part in group]
        mesh = cast(trimesh.Trimesh, trimesh.util.concatenate(shaded))
        vertices, normals = (np.asarray(array, np.float32) for array in (mesh.vertices, mesh.vertex_normals))
        visuals.append(Surface(vertices, np.asarray(mesh.faces, np.uint32), normals, *key))
    return tuple(visuals)


class AssetBuilder(ActorBuilder):
    """ManiSkill actor builder that takes an Asset instead of files."""

    def __init__(
        self, asset: Asset, visuals: tuple[Surface, ...], tint: NDArray[np.float64], mass_kg: float
    ) -> None:
        super().__init__()
        self.asset, self.visuals, self.tint, self.mass_kg = asset, visuals, tint, mass_kg
        self.physx_body_type = "static" if asset.static or asset.visual_only else "dynamic"

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
            for surface in self.visuals:
                body.attach(surface.shape(self.tint))
            entity.add_component(body)
        entity.add_component(self.build_physx_component())
        entity.name = self.name
        return entity


def build(
    scene: ManiSkillScene,
    name: str,
    asset: Asset,
    world_from_object: Matrix,
    *,
    visuals: tuple[Surface, ...] | None = None,
    tint: NDArray[np.float64] = UNTINTED,
    mass_kg: float | None = None,
) -> Actor:
    """Adds an asset to the scene, colours times `tint` (3,); surfaces and mass default to its own."""
    visuals = surfaces(asset) if visuals is None else visuals
    builder: Any = AssetBuilder(asset, visuals, tint, asset.mass_kg if mass_kg is None else mass_kg)
    builder.set_scene(scene)
    builder.initial_pose = sapien_pose(world_from_object)
    return builder.build(name)


def hang(hung: Actor, bearer: Actor, hinge: Hinge, bearer_from_closed: Matrix) -> None:
    """Joins an object to its bearer by a hinge. The two no longer collide; joint limits stop the object."""
    drive = physx.PhysxDriveComponent(hung._bodies[0])
    drive.set_parent(bearer._bodies[0])
    # PhysX twists about the x axis of the joint.
    hinge_from_joint = from_axes((0, 0, 0), z=(1, 0, 0), y=(0, 0, 1))
    hung_from_joint = hinge.object_from_hinge @ hinge_from_joint
    drive.set_pose_in_child(sapien_pose(hung_from_joint))
    drive.set_pose_in_parent(sapien_pose(bearer_from_closed @ hung_from_joint))
    for set_limit in (drive.set_limit_x, drive.set_limit_y, drive.set_limit_z):
        set_limit(0.0, 0.0)
    drive.set_drive_property_swing(*RIGID_SWING)  # limits of zero leave swings free
    drive.set_limit_twist(0.0, float(np.deg2rad(hinge.open_deg)))
    drive.set_drive_property_twist(0.0, hinge.damping_n_m_s)
    hung._objs[0].add_component(drive)


@cache
def _table() -> Asset:
    """A table large enough for every arm of every task, with the floor and the walls."""
    x, y, thick = np.array(TABLE_M) / 2
    cx, cy = TABLE_CENTRE_M
    leg = (-FLOOR_Z_M - 2 * thick) / 2
    ends = product((cx - (x - 0.1), cx + (x - 0.1)), (cy - (y - 0.1), cy + (y - 0.1)))
    legs = [Part.box((0.04, 0.04, leg), transform((*end, FLOOR_Z_M + leg)), LEG) for end in ends]
    floor = Part.box((WALL_DISTANCE_M, WALL_DISTANCE_M, 0.05), transform((0, 0, FLOOR_Z_M - 0.05)), FLOOR)
    walls = [
        Part.box(
            (0.05, WALL_DISTANCE_M, 1.5),
            turn @ transform((WALL_DISTANCE_M, 0, FLOOR_Z_M + 1.5)),
            WALL,
            solid=False,
        )
        for turn in (planar(0, 0, quarter * np.pi / 2) for quarter in range(4))
    ]
    top = Part.box((x, y, thick), transform((cx, cy, -thick)), WOOD)
    return Asset("table", parts=(top, *legs, floor, *walls), static=True)


def build_table(scene: ManiSkillScene, look: Look) -> None:
    """Adds table, floor and walls, the same for every task except for their finishes."""
    finishes = {WOOD: look.table, FLOOR: look.floor, WALL: look.walls}
    visuals = [
        with_finish((surface,), finishes.get(surface.colour, DEFAULT_FINISH))
        for surface in surfaces(_table())
    ]
    build(scene, "table", _table(), transform(), visuals=sum(visuals, ()))
