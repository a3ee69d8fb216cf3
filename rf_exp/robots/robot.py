"""A robot as a value: an arm with a hand of two fingers, as its URDF describes it; and one on its base.

Everything that the suite knows of a robot is asked of this value: joints and their limits, links with their
hulls and meshes, kinematics both ways, the hand. A row of measured joints holds the arm's first, the two
fingers last (..., D); a row of a command the arm's targets first, the gripper last (..., D - 1). Beside a
robot with more joints, those that it lacks lie between them and are zero.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots.mounted import Mounted, Vector, located
from rf_exp.transforms import Matrix, from_axes, inverse

if TYPE_CHECKING:
    import trimesh

    from rf_exp.robots.kinematics import Chain
    from rf_exp.robots.meshes import LinkMesh

_AWAY_RAD = np.linspace(-5.6, 5.6, 57)  # of the last joint
NEIGHBOUR_RAD = 0.35  # postures nearer than this in every joint are on one branch
MARGIN_RAD = 0.02  # to the limits of joints, of postures that are planned

Number = TypeVar("Number", float, NDArray[np.float64])


class Inverse(Protocol):
    """How the joints of one robot are found for a pose of its TCP.

    A robot with a joint to spare has a family of postures for each pose; the angle of its last joint chooses
    one of it. Without one that angle says nothing.
    """

    branches: int  # postures of a pose, at most, given the last joint
    other: NDArray[np.int64]  # of each branch, that in which an arm goes on beyond a singularity; or itself

    def postures(
        self, base_from_tcp: NDArray[np.float64], last_rad: ArrayLike, limits_rad: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Joints (..., branches, dof) rad for TCP poses (..., 4, 4) and the last joint (...), broadcast.

        NaN where there is none within the limits (2, dof).
        """
        ...

    def facing(self, base_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """The last joint (...) rad with which it is least in the way of others, at TCP poses (..., 4, 4)."""
        ...


@dataclass(frozen=True)
class Drive:
    """The controller of some joints."""

    stiffness: float = 1e3
    damping: float = 1e2
    force_limit: float = 100.0


@dataclass(frozen=True)
class Finger:
    """A finger of a hand: what moves it, and where it opens to."""

    link: str  # that touches what is held
    joints: tuple[str, ...]  # that move with it, all alike; the first is measured
    opens: Vector  # direction in the frame of its link
    per_m: float = 1.0  # how far the joints are from `closed` for each metre that it is open
    closed: float = 0.0  # where the joints are when it is closed

    def position(self, open_m: Number) -> Number:
        """Where its joints are, rad or m, when it is so far open."""
        return self.closed + self.per_m * open_m


@dataclass(frozen=True)
class Hand:
    """Two fingers that close on one another, and where the TCP is between them."""

    link: str  # to which cameras and loads are fixed
    tcp: str  # frame: z out of the hand, y along the fingers' way
    fingers: tuple[Finger, Finger]
    open_m: float  # of each finger from the middle, fully open
    pressed_m: float  # where each is told to go when closed: below zero it presses on thin things
    eye_m: Vector = (0.07, 0.0, 0.02)  # a camera in the hand stands here in the frame of the link
    target_m: Vector = (0.0, 0.0, 0.12)  # and looks there
    drive: Drive = Drive()

    @property
    def from_camera(self) -> Matrix:
        """(4, 4) of an eye-in-hand camera in the frame of the link, OpenCV axes."""
        return from_axes(self.eye_m, z=np.subtract(self.target_m, self.eye_m), y=(-1, 0, 0))

    def opening_m(self, command: ArrayLike) -> NDArray[np.float64]:
        """(...) m of each finger from the middle, as planned: gripper commands from -1 closed to 1 open."""
        return self.open_m * (np.clip(command, -1.0, 1.0) + 1.0) / 2.0

    def told_m(self, command: ArrayLike) -> NDArray[np.float64]:
        """(...) m where each finger is sent to."""
        low, high = self.pressed_m, self.open_m
        return low + (np.clip(command, -1.0, 1.0) + 1) / 2 * (high - low)


@dataclass(frozen=True)
class Robot:
    """An arm with its hand. Arms have six or seven revolute joints; the first turns about the base's z."""

    name: str  # the value of `model` in a task
    title: str  # for readers
    # A file, package://PACKAGE/PATH of an installed Python package, or one that is made of two.
    urdf: str | Path | Mounted
    joints: tuple[str, ...]  # of the arm, from the base on
    hand: Hand
    rest_rad: tuple[float, ...]  # of the arm, when it has nothing to do
    aside_rad: tuple[float, ...]  # of the arm, pulled in over its own base
    reach_m: float  # of the TCP from the base
    kind: str = ""  # as others call it, in lower case; `name` unless given
    swivel: int | None = None  # the joint that takes the elbow out of the upright plane, where one does
    reflex_n: float = 20.0  # with which it is pushed until it stops
    drive: Drive = Drive()
    inverse: Callable[["Robot"], Inverse] | None = None  # by Newton steps unless given

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        if self.dof not in (6, 7):
            raise ArgumentError(f"robot {self.name!r} has {self.dof} joints; expected an arm with 6 or 7")
        for name in ("rest_rad", "aside_rad"):
            posture = tuple(map(float, getattr(self, name)))
            object.__setattr__(self, name, posture)
            if len(posture) != self.dof:
                raise ArgumentError(
                    f"robot {self.name!r}: {name} has {len(posture)} values; the arm has {self.dof} joints"
                )
        object.__setattr__(self, "kind", self.kind or self.name)

    def __hash__(self) -> int:
        return hash(self.name)  # it is asked for at every look-up; equality tells the rest

    @property
    def dof(self) -> int:
        """Joints of the arm."""
        return len(self.joints)

    @property
    def spare(self) -> bool:
        """Whether it has a joint more than a pose takes."""
        return self.dof > 6

    @property
    def urdf_path(self) -> Path:
        """Raises StageError where the package that it lies in is not installed."""
        return self.urdf.path if isinstance(self.urdf, Mounted) else located(self.urdf)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names along a row of measured joints: the arm's, then of each finger."""
        fingers = (finger.joints[0] if finger.joints else finger.link for finger in self.hand.fingers)
        return (*self.joints, *fingers)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of all joints that move: the arm's, then those of the fingers."""
        return (*self.joints, *(joint for finger in self.hand.fingers for joint in finger.joints))

    @property
    def told(self) -> tuple[str, ...]:
        """Names along a row of a command."""
        return (*self.joints, "gripper")

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links with collision shapes, in the order of the URDF; the base is the first."""
        from rf_exp.robots import urdf

        return urdf.solid_links(self)

    @property
    def gripper(self) -> frozenset[str]:
        """The links that may touch what is to be held."""
        return frozenset({self.hand.link, *(finger.link for finger in self.hand.fingers)})

    @property
    def limits_rad(self) -> NDArray[np.float64]:
        """(2, dof) lower and upper joint limits of the arm."""
        return self._chain.limits_rad

    @property
    def planned_rad(self) -> NDArray[np.float64]:
        """(2, dof) between which postures are planned, a small margin within the limits."""
        return self.limits_rad + np.array([[MARGIN_RAD], [-MARGIN_RAD]])

    @property
    def hulls(self) -> "Mapping[str, trimesh.Trimesh]":
        """Convex hull of the collision shapes of every link in `links`, in the frame of the link, metres."""
        from rf_exp.robots import urdf

        return urdf.hulls(self)

    @property
    def self_pairs(self) -> tuple[tuple[int, int], ...]:
        """Index pairs into `links` whose contact is a self-collision."""
        from rf_exp.robots import urdf

        return urdf.self_pairs(self)

    @property
    def meshes(self) -> "Mapping[str, LinkMesh]":
        """Link -> vertices (V, 3) in metres in its frame, faces (F, 3), linear RGB (V, 3), few triangles."""
        from rf_exp.robots.meshes import light_meshes

        return light_meshes(self)

    @property
    def identity(self) -> dict[str, Any]:
        """What decides how it moves."""
        content = hashlib.sha256(self.urdf_path.read_bytes()).hexdigest()[:16]
        about = {"urdf": content, "hand": repr(self.hand), "aside_rad": list(self.aside_rad)}
        return {"name": self.name, **about, "reach_m": self.reach_m, "drive": repr(self.drive)}

    def link_poses(self, qpos: NDArray[np.floating]) -> NDArray[np.float64]:
        """Base-frame poses of `links` for measured joints (..., D) rad and metres: (..., L, 4, 4)."""
        return self._chain.link_poses(qpos)

    def tcp_pose(self, joints: NDArray[np.floating]) -> NDArray[np.float64]:
        """base_from_tcp (..., 4, 4) for rows that begin with the joints of the arm, rad."""
        return self._chain.tcp_pose(joints)

    @property
    def solver(self) -> Inverse:
        """Its inverse kinematics."""
        from rf_exp.robots.kinematics import solver_of

        return solver_of(self)

    @property
    def _chain(self) -> "Chain":
        from rf_exp.robots.kinematics import chain_of  # a task is read without Pinocchio

        return chain_of(self)


class Arm:
    """A robot that is bolted to the table: kinematics in the world, at `world_from_base` (4, 4)."""

    def __init__(self, robot: Robot, world_from_base: Matrix) -> None:
        self.robot, self.world_from_base = robot, world_from_base
        self._base_from_world = inverse(world_from_base)
        self._solver, self._limits_rad = robot.solver, robot.planned_rad

    def joints(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., dof) of this arm, of measured joints or commands (..., D) of a task with more."""
        return rows[..., : self.robot.dof]

    def tcp(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """world_from_tcp (..., 4, 4) for rows that begin with the joints of the arm, rad."""
        return self.world_from_base @ self.robot.tcp_pose(qpos)

    def links(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """World poses of the robot's links (..., L, 4, 4) for measured joints (..., D)."""
        return self.world_from_base @ self.robot.link_poses(qpos)

    def postures(self, world_from_tcp: NDArray[np.float64], last_rad: ArrayLike) -> NDArray[np.float64]:
        """See `Inverse`, for poses in the world, within the joint limits and a small margin."""
        return self._solver.postures(self._base_from_world @ world_from_tcp, last_rad, self._limits_rad)

    def facing(self, world_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Inverse`, for poses in the world."""
        return self._solver.facing(self._base_from_world @ world_from_tcp)

    def aside_rad(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) rad by which the elbow is out of the upright plane at joints (..., dof)."""
        swivel = self.robot.swivel
        return np.zeros(joints.shape[:-1]) if swivel is None else np.abs(joints[..., swivel])

    def beyond(self, branch: int) -> int:
        """The branch in which an arm goes on beyond a singularity, an upright shoulder for one."""
        return int(self._solver.other[branch])

    def crossed(self, found: NDArray[np.float64]) -> NDArray[np.float64]:
        """Postures (..., branches, dof), each in place of the one of `beyond`, laid out as `postures` are."""
        return np.moveaxis(np.moveaxis(found, -1, 0).take(self._solver.other, axis=-1), 0, -1)

    def solve(self, world_from_tcp: Matrix, near_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joints (dof,) rad that put the TCP at a pose, near to `near_rad`; None where there are none.

        The last joint of an arm with one to spare stays as it is where a neighbouring posture allows that, so
        along a path of near poses the joints go smoothly; otherwise it is the nearest posture of a range.
        """
        near_rad = self.joints(near_rad)
        last = near_rad[-1]
        ranges = (
            [([last], NEIGHBOUR_RAD), (last + _AWAY_RAD, np.inf)] if self.robot.spare else [([last], np.inf)]
        )
        for turns, farthest in ranges:
            found = self.postures(world_from_tcp, turns).reshape(-1, self.robot.dof)
            away = np.abs(found - near_rad).max(axis=1)
            nearest = int(np.nan_to_num(away, nan=np.inf).argmin())
            if away[nearest] < farthest:
                return found[nearest]
        return None
