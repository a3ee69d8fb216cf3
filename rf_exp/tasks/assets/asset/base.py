"""Asset: a rigid body of convex parts with mass, friction and annotated interaction points.

The annotation of interaction positions and directions follows the paper, section 3.2: each point holds the
pose of the gripper and the direction of its approach.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.artifacts import digest, drop_defaults
from rf_exp.errors import ArgumentError
from rf_exp.transforms import Matrix, apply, equal_rotations, from_axes, inverse

if TYPE_CHECKING:
    import trimesh  # slow to import, so only where parts are created, after the command line is parsed

Colour = tuple[float, float, float]  # linear RGB in [0, 1]

CONVEX_RATIO = 1.01  # a shell counts as convex up to this ratio of its convex hull's volume to its own
MAX_VERTICES = 200  # most vertices of a convex piece; the limit of PhysX is 255
# coacd: half its default accuracy, in a fifth of the time
COACD_OPTIONS = {
    "threshold": 0.05,
    "resolution": 1000,
    "mcts_iterations": 20,
    "mcts_nodes": 10,
    "mcts_max_depth": 2,
}


@dataclass(frozen=True)
class Part:
    """One convex piece of a rigid body, in the frame of its asset."""

    mesh: "trimesh.Trimesh"  # convex, metres, already placed in the asset's frame
    colour: Colour
    solid: bool = True  # takes part in collisions
    visible: bool = True  # is rendered
    roughness: float = 0.6
    metallic: float = 0.0

    @staticmethod
    def box(half_extents_m, object_from_part: Matrix, colour: Colour, **keywords) -> "Part":
        """A box of half extents (3,) at a pose in the asset's frame."""
        import trimesh

        mesh = trimesh.creation.box(2 * np.asarray(half_extents_m), object_from_part)
        return Part(mesh, colour, **keywords)

    @staticmethod
    def cylinder(
        radius_m: float, height_m: float, object_from_part: Matrix, colour: Colour, **keywords
    ) -> "Part":
        """A cylinder about the z axis of its pose, centred there."""
        import trimesh

        mesh = trimesh.creation.cylinder(radius_m, height_m, sections=24, transform=object_from_part)
        return Part(mesh, colour, **keywords)

    @staticmethod
    def sphere(radius_m: float, object_from_part: Matrix, colour: Colour, **keywords) -> "Part":
        import trimesh

        mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius_m)
        return Part(mesh.apply_transform(object_from_part), colour, **keywords)

    @staticmethod
    def hull(points: NDArray[np.float64], colour: Colour, **keywords) -> "Part":
        """The convex hull of points (K, 3) in the asset's frame."""
        import trimesh

        return Part(trimesh.convex.convex_hull(points), colour, **keywords)


@dataclass(frozen=True)
class InteractionPoint:
    """Interaction point: pose at which the gripper, or another object, meets the asset, by kind.

    grasp, press, shut: `object_from_tcp` is the pose of the tool centre point at contact. Its z axis is the
    approach direction, its y axis the direction in which the fingers close.
    place, drop: the pose of the frame of the placed object, z up; set down there or released above it.
    tool: the working part of a held object, its z axis along the working direction.
    """

    object_from_tcp: Matrix
    kind: str  # grasp | press | shut | place | drop | tool
    standoff_m: float = 0.08  # distance at which a straight approach begins
    width_m: float = 0.04  # between the fingers when closed on it (grasp)
    turns: int = 2  # rotational symmetry about z: 2 for two fingers, 4 for a square
    around: int = 1  # rotational symmetry about the asset's z axis (grasp, press, shut)
    tip_deg: float = 0.0  # allowed tilt of the gripper about its closing axis (grasp)
    slack_m: float = 0.0  # allowed horizontal offset of the placed object (place, drop)

    @staticmethod
    def from_above(position_m, kind: str = "grasp", **keywords) -> "InteractionPoint":
        """A point approached straight from above at a position (3,); the fingers close along y."""
        return InteractionPoint(from_axes(position_m, z=(0, 0, -1), y=(0, 1, 0)), kind, **keywords)

    @property
    def equivalent_poses(self) -> tuple[Matrix, ...]:
        """The equivalent poses `object_from_tcp`, by the symmetry `around` the asset's z axis."""
        return tuple(turn @ self.object_from_tcp for turn in equal_rotations(self.around))

    def scaled(self, size: float) -> "InteractionPoint":
        """The point of the asset scaled by `size`; lengths of the gripper's approach are not scaled."""
        pose = self.object_from_tcp.copy()
        pose[:3, 3] *= size
        return replace(self, object_from_tcp=pose, width_m=size * self.width_m, slack_m=size * self.slack_m)


@dataclass(frozen=True)
class Hinge:
    """Hinge of an object on the object that bears it: a lid, a door.

    The axis is the y axis of `object_from_hinge`. At angle 0 the object is closed, in its nominal pose on the
    bearer; it opens up to `open_deg`, where a stop holds it.
    """

    object_from_hinge: Matrix
    open_deg: float
    falls_deg: float  # below this angle it closes by its own weight ...
    falls_s: float  # ... within this time
    damping_n_m_s: float  # torque against a rotation at 1 rad/s

    def closed_from_object(self, angle_rad: ArrayLike) -> NDArray[np.float64]:
        """Poses closed_from_object (..., 4, 4) at opening angles (...)."""
        angles = np.asarray(angle_rad, dtype=float)
        turn = np.broadcast_to(np.eye(4), (*angles.shape, 4, 4)).copy()
        turn[..., 0, 0] = turn[..., 2, 2] = np.cos(angles)
        turn[..., 0, 2] = np.sin(angles)
        turn[..., 2, 0] = -turn[..., 0, 2]
        return self.object_from_hinge @ turn @ inverse(self.object_from_hinge)

    def angle_rad(self, closed_from_object: Matrix) -> NDArray[np.float64]:
        """Opening angles (...) at poses (..., 4, 4) relative to the closed pose."""
        turn = inverse(self.object_from_hinge) @ closed_from_object @ self.object_from_hinge
        return np.arctan2(turn[..., 0, 2], turn[..., 0, 0])

    def scaled(self, size: float) -> "Hinge":
        """The hinge of the object scaled by `size`: angles and times stay, damping grows with size^4."""
        pose = self.object_from_hinge.copy()
        pose[:3, 3] *= size
        return replace(self, object_from_hinge=pose, damping_n_m_s=size**4 * self.damping_n_m_s)


@dataclass(frozen=True, eq=False)
class Asset:
    """A rigid body. The origin is the centre of its underside unless its module says otherwise."""

    name: str
    parts: tuple[Part, ...]
    points: Mapping[str, InteractionPoint] = field(default_factory=dict)
    mass_kg: float = 0.1
    heaviest_kg: float | None = None  # upper end of `Randomisation.mass_scale`
    friction: float = 1.0
    static: bool = False  # fixed to the world
    visual_only: bool = False  # a mark on the table: rendered, without collision
    hinge: Hinge | None = None  # on the object that it is relative to

    def __post_init__(self) -> None:
        for name, point in self.points.items():
            if point.kind == "shut" and self.hinge is None:
                raise ArgumentError(f"point {name!r} is to shut {self.name}, which has no hinge")

    @cached_property
    def hulls(self) -> "tuple[trimesh.Trimesh, ...]":
        """Meshes of the convex solid parts, in the asset's frame."""
        return tuple(part.mesh for part in self.parts if part.solid and not self.visual_only)

    @cached_property
    def content_digest(self) -> str:
        """Digest of everything but the name: the same for the same file or code."""
        parts = [  # names of keys as in existing digests
            {
                "vertices": _rounded(part.mesh.vertices),
                "faces": part.mesh.faces,
                **{name: _rounded(getattr(part, name)) for name in ("colour", "roughness", "metallic")},
                "solid": part.solid,
                "seen": part.visible,
            }
            for part in self.parts
        ]
        points = {  # defaults of `around` and `hinge` are left out: older digests stay valid
            name: drop_defaults({**vars(point), "object_from_tcp": _rounded(point.object_from_tcp)}, around=1)
            for name, point in self.points.items()
        }
        hinge = self.hinge and {
            **vars(self.hinge),
            "object_from_hinge": _rounded(self.hinge.object_from_hinge),
        }
        rest = {name: getattr(self, name) for name in ("mass_kg", "heaviest_kg", "friction", "static")}
        content = {"parts": parts, "points": points, **rest, "ghost": self.visual_only}
        return digest(drop_defaults({**content, "hinge": hinge}, hinge=None))

    @property
    def placement_points(self) -> Mapping[str, InteractionPoint]:
        """Points of kind place or drop; the first is the default."""
        return {name: point for name, point in self.points.items() if point.kind in ("place", "drop")}

    @cached_property
    def bounds_m(self) -> NDArray[np.float64]:
        """(2, 3) lowest and highest corner of all parts, in the asset's frame."""
        corners = np.concatenate([part.mesh.bounds for part in self.parts])
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def vertices(self, world_from_object: Matrix) -> NDArray[np.float64]:
        """All vertices (K, 3) of the solid parts, in the world."""
        return apply(world_from_object, np.concatenate([hull.vertices for hull in self.hulls]))

    def scaled(self, size: float) -> "Asset":
        """The asset scaled by `size` at the same density; the same instance for the same size."""
        return self if size == 1 else _scaled(self, size)


@lru_cache(maxsize=256)  # bounded: sizes differ from scene to scene
def _scaled(asset: Asset, size: float) -> Asset:
    parts = tuple(replace(part, mesh=part.mesh.copy().apply_scale(size)) for part in asset.parts)
    points = {name: point.scaled(size) for name, point in asset.points.items()}
    heaviest_kg = None if asset.heaviest_kg is None else size**3 * asset.heaviest_kg
    mass_kg = size**3 * asset.mass_kg
    hinge = None if asset.hinge is None else asset.hinge.scaled(size)
    changed = {"points": points, "mass_kg": mass_kg, "heaviest_kg": heaviest_kg, "hinge": hinge}
    return replace(asset, parts=parts, **changed)


def _rounded(values: object) -> NDArray[np.floating]:
    """Rounded to 0.1 um, as the last bits may differ between processors."""
    return np.round(np.asarray(values, float), 7) + 0.0  # + 0.0: no -0.0


def convex_pieces(shell: "trimesh.Trimesh") -> "list[trimesh.Trimesh]":
    """Convex decomposition of a closed shell; deterministic."""
    import coacd
    import trimesh

    hull = shell.convex_hull
    if hull.volume <= CONVEX_RATIO * shell.volume and len(hull.vertices) <= MAX_VERTICES:
        return [hull]
    coacd.set_log_level("error")
    pieces = coacd.run_coacd(
        coacd.Mesh(shell.vertices, shell.faces),
        max_ch_vertex=MAX_VERTICES,
        decimate=True,
        seed=0,
        **COACD_OPTIONS,
    )
    return [trimesh.convex.convex_hull(vertices) for vertices, _ in pieces]
