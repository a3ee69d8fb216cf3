"""What an asset is: convex parts, mass, friction, and where and how to interact with it.

The annotation of interaction positions and directions follows the paper, section 3.2: each point
says where the gripper goes and from which direction it comes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.artifacts import digest, without
from rf_exp.errors import ArgumentError
from rf_exp.transforms import Matrix, apply, equal_turns, from_axes, inverse

if TYPE_CHECKING:
    import trimesh  # slow to import: where a part is made, after the command line is understood

Colour = tuple[float, float, float]  # linear RGB in [0, 1]

CONVEX = 1.01  # a shell whose convex hull is at most so many times as large counts as convex
CORNERS = 200  # of a convex piece; PhysX takes 255
# coacd: half of its usual accuracy, in a fifth of the time
SEARCH = {"threshold": 0.05, "resolution": 1000, "mcts_iterations": 20, "mcts_nodes": 10, "mcts_max_depth": 2}


@dataclass(frozen=True)
class Part:
    """One convex piece of a rigid body, in the frame of its asset."""

    mesh: "trimesh.Trimesh"  # convex, metres, already placed in the asset's frame
    colour: Colour
    solid: bool = True  # takes part in collisions
    seen: bool = True  # takes part in pictures
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
        """A cylinder about the z axis of its pose, centred on it."""
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
    """Where and from which direction the gripper, or another thing, meets the asset.

    grasp, press, shut: `object_from_tcp` is the pose of the tool centre point at contact. Its z axis is the
    direction the gripper comes along, its y axis the one the fingers close along.
    place, drop: the pose that the frame of what is placed takes, z up; on it, or let go above it.
    tool: the part of a held thing that does the work, its z axis pointing where it works.
    """

    object_from_tcp: Matrix
    kind: str  # grasp | press | shut | place | drop | tool
    standoff_m: float = 0.08  # where a straight approach begins
    width_m: float = 0.04  # between the fingers when closed on it (grasp)
    turns: int = 2  # so many equal turns about z serve as well: two fingers 2, a square 4
    around: int = 1  # so many equal turns of the hand about the asset's own z axis as well (grasp, press)
    tip_deg: float = 0.0  # the gripper may be tipped so far about the axis it closes along (grasp)
    slack_m: float = 0.0  # how far off, on the level, a thing may be placed (place, drop)

    @staticmethod
    def from_above(position_m, kind: str = "grasp", **keywords) -> "InteractionPoint":
        """Straight from above at a position (3,), the fingers closing along y."""
        return InteractionPoint(from_axes(position_m, z=(0, 0, -1), y=(0, 1, 0)), kind, **keywords)

    @property
    def alike(self) -> tuple[Matrix, ...]:
        """`object_from_tcp` itself, and where equal turns about the asset's z axis bring it."""
        return tuple(turn @ self.object_from_tcp for turn in equal_turns(self.around))

    def scaled(self, size: float) -> "InteractionPoint":
        """Of a thing that is `size` times as large: the hand that comes to it is not."""
        pose = self.object_from_tcp.copy()
        pose[:3, 3] *= size
        return replace(self, object_from_tcp=pose, width_m=size * self.width_m, slack_m=size * self.slack_m)


@dataclass(frozen=True)
class Hinge:
    """What a thing turns about where it is hung on another one, which bears it: a lid, a door.

    It turns about the y axis of `object_from_hinge`. At 0 it is shut, where the task puts it on its bearer;
    it opens up to `open_deg`, where a stop holds it.
    """

    object_from_hinge: Matrix
    open_deg: float
    falls_deg: float  # less open than this it falls shut by its own weight ...
    falls_s: float  # ... within this time
    damping_n_m_s: float  # torque against a turn by 1 rad/s

    def turned(self, opened_rad: ArrayLike) -> NDArray[np.float64]:
        """(..., 4, 4) shut_from_object of the thing where it is open so far (...)."""
        angles = np.asarray(opened_rad, dtype=float)
        turn = np.broadcast_to(np.eye(4), (*angles.shape, 4, 4)).copy()
        turn[..., 0, 0] = turn[..., 2, 2] = np.cos(angles)
        turn[..., 0, 2] = np.sin(angles)
        turn[..., 2, 0] = -turn[..., 0, 2]
        return self.object_from_hinge @ turn @ inverse(self.object_from_hinge)

    def opened_rad(self, shut_from_object: Matrix) -> NDArray[np.float64]:
        """(...) how far a thing at poses (..., 4, 4) is open."""
        turn = inverse(self.object_from_hinge) @ shut_from_object @ self.object_from_hinge
        return np.arctan2(turn[..., 0, 2], turn[..., 0, 0])

    def scaled(self, size: float) -> "Hinge":
        """Of a thing that is `size` times as large: its weight shuts it as soon."""
        pose = self.object_from_hinge.copy()
        pose[:3, 3] *= size
        return replace(self, object_from_hinge=pose, damping_n_m_s=size**4 * self.damping_n_m_s)


@dataclass(frozen=True, eq=False)
class Asset:
    """A rigid body. Origin on its underside centre unless its module says otherwise."""

    name: str
    parts: tuple[Part, ...]
    points: Mapping[str, InteractionPoint] = field(default_factory=dict)
    mass_kg: float = 0.1
    heaviest_kg: float | None = None  # of its heaviest make, where `Randomisation.mass_scale` asks for some
    friction: float = 1.0
    static: bool = False  # fixed to the world
    ghost: bool = False  # a mark on the table: seen, never touched
    hinge: Hinge | None = None  # by which it hangs on what it is relative to

    def __post_init__(self) -> None:
        for name, point in self.points.items():
            if point.kind == "shut" and self.hinge is None:
                raise ArgumentError(f"point {name!r} is to shut {self.name}, which has no hinge")

    @cached_property
    def hulls(self) -> "tuple[trimesh.Trimesh, ...]":
        """The convex solid parts in the frame of the asset."""
        return tuple(part.mesh for part in self.parts if part.solid and not self.ghost)

    @cached_property
    def content(self) -> str:
        """A digest of all that it is, but for its name: what the same file makes, or the same code."""
        parts = [
            {
                "vertices": _rounded(part.mesh.vertices),
                "faces": part.mesh.faces,
                **{name: _rounded(getattr(part, name)) for name in ("colour", "roughness", "metallic")},
                "solid": part.solid,
                "seen": part.seen,
            }
            for part in self.parts
        ]
        points = {  # contents are as they were before there was such a symmetry, and before there were hinges
            name: without({**vars(point), "object_from_tcp": _rounded(point.object_from_tcp)}, around=1)
            for name, point in self.points.items()
        }
        hinge = self.hinge and {
            **vars(self.hinge),
            "object_from_hinge": _rounded(self.hinge.object_from_hinge),
        }
        rest = ("mass_kg", "heaviest_kg", "friction", "static", "ghost")
        said = {"parts": parts, "points": points, **{name: getattr(self, name) for name in rest}}
        return digest(without({**said, "hinge": hinge}, hinge=None))

    @property
    def placing(self) -> Mapping[str, InteractionPoint]:
        """Its points at which something is placed or dropped; the first is the usual one."""
        return {name: point for name, point in self.points.items() if point.kind in ("place", "drop")}

    @cached_property
    def bounds_m(self) -> NDArray[np.float64]:
        """(2, 3) lowest and highest corner of all parts in the frame of the asset."""
        corners = np.concatenate([part.mesh.bounds for part in self.parts])
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def vertices(self, world_from_object: Matrix) -> NDArray[np.float64]:
        """All vertices of the solid parts (K, 3) in the world."""
        return apply(world_from_object, np.concatenate([hull.vertices for hull in self.hulls]))

    def scaled(self, size: float) -> "Asset":
        """The same thing `size` times as large, of the same density; the same object for the same size."""
        return self if size == 1 else _scaled(self, size)


@lru_cache(maxsize=256)  # sizes differ from scene to scene
def _scaled(asset: Asset, size: float) -> Asset:
    parts = tuple(replace(part, mesh=part.mesh.copy().apply_scale(size)) for part in asset.parts)
    points = {name: point.scaled(size) for name, point in asset.points.items()}
    heaviest_kg = None if asset.heaviest_kg is None else size**3 * asset.heaviest_kg
    mass_kg = size**3 * asset.mass_kg
    hinge = None if asset.hinge is None else asset.hinge.scaled(size)
    changed = {"points": points, "mass_kg": mass_kg, "heaviest_kg": heaviest_kg, "hinge": hinge}
    return replace(asset, parts=parts, **changed)


def _rounded(values: object) -> NDArray[np.floating]:
    """To 0.1 um: the last bits may differ from one processor to the next."""
    return np.round(np.asarray(values, float), 7) + 0.0  # + 0.0: no -0.0


def convex_pieces(shell: "trimesh.Trimesh") -> "list[trimesh.Trimesh]":
    """Convex pieces that together fill a closed shell; the same on every call."""
    import coacd
    import trimesh

    hull = shell.convex_hull
    if hull.volume <= CONVEX * shell.volume and len(hull.vertices) <= CORNERS:
        return [hull]
    coacd.set_log_level("error")
    pieces = coacd.run_coacd(
        coacd.Mesh(shell.vertices, shell.faces), max_ch_vertex=CORNERS, decimate=True, seed=0, **SEARCH
    )
    return [trimesh.convex.convex_hull(vertices) for vertices, _ in pieces]
