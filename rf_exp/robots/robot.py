"""Robot: an arm with a two-finger gripper, described by a URDF; and `Arm`: a robot at its base.

A robot is a value with all that the suite uses: joints and limits, links with their hulls and meshes,
forward and inverse kinematics, the gripper. A row of measured joints (..., D) holds the arm's joints first
and the two fingers last; a row of a command (..., D - 1) the arm's targets first and the gripper last. In a
task with robots of more joints, the columns that a robot lacks are between these and are zero.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots.mounted import Mounted, Vector, resolve_urdf
from rf_exp.transforms import Matrix, from_axes, inverse

if TYPE_CHECKING:
    import trimesh

    from rf_exp.robots.kinematics import Chain
    from rf_exp.robots.meshes import LinkMesh

_OFFSETS_RAD = np.linspace(-5.6, 5.6, 57)  # offsets of the last joint that `Arm.solve` tries
NEIGHBOUR_RAD = 0.35  # postures closer than this in every joint are on one branch
MARGIN_RAD = 0.02  # between planned postures and the joint limits

Number = TypeVar("Number", float, NDArray[np.float64])


class Inverse(Protocol):
    """Inverse kinematics of one robot.

    A robot with a redundant joint has a family of postures for each TCP pose, and the angle of its last joint
    selects from it. For other robots that angle has no meaning.
    """

    branches: int  # most postures of a pose, given the last joint
    # (branches,) the branch in which each continues beyond a singularity, or itself
    opposite_branch: NDArray[np.int64]

    def postures(
        self, base_from_tcp: NDArray[np.float64], last_rad: ArrayLike, limits_rad: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Joints (..., branches, dof) rad for TCP poses (..., 4, 4) and the last joint (...), broadcast.

        NaN where a branch has no posture within the limits (2, dof).
        """
        ...

    def preferred_last_rad(self, base_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """The last joint (...) rad that is least in the way of other arms, at TCP poses (..., 4, 4)."""
        ...


@dataclass(frozen=True)
class Drive:
    """PD controller of a group of joints."""

    stiffness: float = 1e3
    damping: float = 1e2
    force_limit: float = 100.0


@dataclass(frozen=True)
class Finger:
    """A finger of a gripper: its link, its joints and its opening direction."""

    link: str  # in contact with a held object
    joints: tuple[str, ...]  # of this finger, all with the same position; the first is measured
    opens: Vector  # opening direction, in the frame of its link
    per_m: float = 1.0  # joint displacement from `closed` per metre of opening
    closed: float = 0.0  # joint position when closed

    def position(self, open_m: Number) -> Number:
        """Joint position, rad or m, for an opening."""
        return self.closed + self.per_m * open_m


@dataclass(frozen=True)
class Hand:
    """Two-finger gripper with its TCP between the fingers."""

    link: str  # that carries cameras and loads
    tcp: str  # frame: z out of the gripper, y along the motion of the fingers
    fingers: tuple[Finger, Finger]
    open_m: float  # of each finger from the middle, fully open
    pressed_m: float  # target of each finger when closed; below zero, so that it presses on thin objects
    eye_m: Vector = (0.07, 0.0, 0.02)  # position of an eye-in-hand camera in the frame of `link`
    target_m: Vector = (0.0, 0.0, 0.12)  # point that it looks at, in the same frame
    drive: Drive = Drive()

    @property
    def from_camera(self) -> Matrix:
        """Pose (4, 4) of an eye-in-hand camera in the frame of `link`, OpenCV axes."""
        return from_axes(self.eye_m, z=np.subtract(self.target_m, self.eye_m), y=(-1, 0, 0))

    def opening_m(self, command: ArrayLike) -> NDArray[np.float64]:
        """Planned opening (...) of each finger from the middle, m, for commands from -1 closed to 1 open."""
        return self.open_m * (np.clip(command, -1.0, 1.0) + 1.0) / 2.0

    def finger_target_m(self, command: ArrayLike) -> NDArray[np.float64]:
        """Drive target (...) of each finger from the middle, m, for the same commands."""
        low, high = self.pressed_m, self.open_m
        return low + (np.clip(command, -1.0, 1.0) + 1) / 2 * (high - low)


@dataclass(frozen=True)
class Robot:
    """An arm with its gripper. Arms have six or seven revolute joints; the first turns about the base's z.

    Raises ArgumentError for another number of joints, and for postures of another length.
    """

    name: str  # the value of `model` in a task
    title: str  # for display
    # A file, package://PACKAGE/PATH in an installed Python package, or a combination of two URDFs.
    urdf: str | Path | Mounted
    joints: tuple[str, ...]  # of the arm, starting at the base
    hand: Hand
    rest_rad: tuple[float, ...]  # posture of an idle arm
    aside_rad: tuple[float, ...]  # posture retracted over its own base
    reach_m: float  # of the TCP from the base
    kind: str = ""  # robot's name in exported data sets, in lower case; default `name`
    swivel: int | None = None  # index of the joint that turns the elbow out of the vertical plane, if any
    reflex_n: float = 20.0  # contact force above which the real arm would stop
    drive: Drive = Drive()
    inverse: Callable[["Robot"], Inverse] | None = None  # default: Newton steps

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
        return hash(self.name)  # cheap, for cache look-ups; equality compares all fields

    @property
    def dof(self) -> int:
        """Number of joints of the arm."""
        return len(self.joints)

    @property
    def is_redundant(self) -> bool:
        """Whether the arm has a redundant joint."""
        return self.dof > 6

    @property
    def urdf_path(self) -> Path:
        """Path of the URDF. Raises StageError where the package that contains it is not installed."""
        return self.urdf.path if isinstance(self.urdf, Mounted) else resolve_urdf(self.urdf)

    @property
    def qpos_names(self) -> tuple[str, ...]:
        """Names of the columns of measured joints: the arm's, then one per finger."""
        fingers = (finger.joints[0] if finger.joints else finger.link for finger in self.hand.fingers)
        return (*self.joints, *fingers)

    @property
    def active_joints(self) -> tuple[str, ...]:
        """Names of all movable joints: the arm's, then the fingers'."""
        return (*self.joints, *(joint for finger in self.hand.fingers for joint in finger.joints))

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the columns of a command."""
        return (*self.joints, "gripper")

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links with collision shapes, in the order of the URDF; the base is the first."""
        from rf_exp.robots import urdf

        return urdf.solid_links(self)

    @property
    def gripper(self) -> frozenset[str]:
        """The links that may touch an object to be grasped."""
        return frozenset({self.hand.link, *(finger.link for finger in self.hand.fingers)})

    @property
    def limits_rad(self) -> NDArray[np.float64]:
        """(2, dof) lower and upper joint limits of the arm."""
        return self._chain.limits_rad

    @property
    def planned_rad(self) -> NDArray[np.float64]:
        """(2, dof) limits of planned postures, `MARGIN_RAD` within the joint limits."""
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
        """Link -> simplified mesh: vertices (V, 3) in its frame in m, faces (F, 3), linear RGB (V, 3)."""
        from rf_exp.robots.meshes import simplified_meshes

        return simplified_meshes(self)

    @property
    def identity(self) -> dict[str, Any]:
        """All that determines its motion, for identities of artifacts."""
        content = hashlib.sha256(self.urdf_path.read_bytes()).hexdigest()[:16]
        motion = {"urdf": content, "hand": repr(self.hand), "aside_rad": list(self.aside_rad)}
        return {"name": self.name, **motion, "reach_m": self.reach_m, "drive": repr(self.drive)}

    def link_poses(self, qpos: NDArray[np.floating]) -> NDArray[np.float64]:
        """Base-frame poses of `links` for measured joints (..., D) rad and metres: (..., L, 4, 4)."""
        return self._chain.link_poses(qpos)

    def tcp_pose(self, joints: NDArray[np.floating]) -> NDArray[np.float64]:
        """base_from_tcp (..., 4, 4) for rows that begin with the joints of the arm, rad."""
        return self._chain.tcp_pose(joints)

    @property
    def solver(self) -> Inverse:
        """Inverse kinematics of the robot."""
        from rf_exp.robots.kinematics import solver_of

        return solver_of(self)

    @property
    def _chain(self) -> "Chain":
        from rf_exp.robots.kinematics import chain_of  # not above: reading a task does not need Pinocchio

        return chain_of(self)


class Arm:
    """A robot mounted at `world_from_base` (4, 4): kinematics in the world frame."""

    def __init__(self, robot: Robot, world_from_base: Matrix) -> None:
        self.robot, self.world_from_base = robot, world_from_base
        self._base_from_world = inverse(world_from_base)
        self._solver, self._limits_rad = robot.solver, robot.planned_rad

    def joints(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """The arm's joints (..., dof) from rows (..., D) of measured joints or commands."""
        return rows[..., : self.robot.dof]

    def tcp(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """world_from_tcp (..., 4, 4) for rows that begin with the joints of the arm, rad."""
        return self.world_from_base @ self.robot.tcp_pose(qpos)

    def links(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """World poses of the robot's links (..., L, 4, 4) for measured joints (..., D)."""
        return self.world_from_base @ self.robot.link_poses(qpos)

    def postures(self, world_from_tcp: NDArray[np.float64], last_rad: ArrayLike) -> NDArray[np.float64]:
        """See `Inverse`, for poses in the world frame and `Robot.planned_rad` as limits."""
        return self._solver.postures(self._base_from_world @ world_from_tcp, last_rad, self._limits_rad)

    def preferred_last_rad(self, world_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Inverse`, for poses in the world frame."""
        return self._solver.preferred_last_rad(self._base_from_world @ world_from_tcp)

    def elbow_angle_rad(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Absolute angle (...) in rad of the elbow from the vertical plane, at joints (..., dof)."""
        swivel = self.robot.swivel
        return np.zeros(joints.shape[:-1]) if swivel is None else np.abs(joints[..., swivel])

    def branch_beyond_singularity(self, branch: int) -> int:
        """The branch in which an arm continues beyond a singularity, such as an upright shoulder."""
        return int(self._solver.opposite_branch[branch])

    def permuted_to_opposite(self, postures: NDArray[np.float64]) -> NDArray[np.float64]:
        """Postures (..., branches, dof) permuted: branch k holds that of `branch_beyond_singularity(k)`."""
        return np.moveaxis(np.moveaxis(postures, -1, 0).take(self._solver.opposite_branch, axis=-1), 0, -1)

    def solve(self, world_from_tcp: Matrix, near_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joints (dof,) rad that put the TCP at a pose, nearest to `near_rad`; None where there are none.

        The last joint of a redundant arm keeps its angle where this gives a posture within `NEIGHBOUR_RAD`,
        so that the joints move smoothly along a path of close poses; otherwise a range of angles is tried.
        """
        near_rad = self.joints(near_rad)
        last_rad = near_rad[-1]
        ranges = (
            [([last_rad], NEIGHBOUR_RAD), (last_rad + _OFFSETS_RAD, np.inf)]
            if self.robot.is_redundant
            else [([last_rad], np.inf)]
        )
        for candidates_rad, limit_rad in ranges:
            postures = self.postures(world_from_tcp, candidates_rad).reshape(-1, self.robot.dof)
            distances_rad = np.abs(postures - near_rad).max(axis=1)
            nearest = int(np.nan_to_num(distances_rad, nan=np.inf).argmin())
            if distances_rad[nearest] < limit_rad:
                return postures[nearest]
        return None
