"""What is measured at one control step, what the success criteria say of it, and all steps of an episode."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Account, Violation, bound_text
from rf_exp.transforms import Matrix

CONTROL_HZ = 20
CONTROL_DT_S = 1.0 / CONTROL_HZ
ARM_JOINTS = 7  # that policies take; everybody else asks the robots of a task
GRIPPER_OPEN, GRIPPER_CLOSED = 1.0, -1.0  # gripper command, ManiSkill's normalised width

# Streams of random numbers of an episode: `default_rng([seed, STREAM, ...])`. Each serves one thing; faults
# of a brain are drawn where disturbances are. NumPy fills a seed up with zeros: who draws from
# `[seed, STREAM]` and from `[seed, STREAM, 0]` draws the same numbers twice. Further numbers begin at 1 then.
SCENE, PLANNING, DISTURBANCES, CORRECTION, PIXELS, FLICKER, VARIATION, PROPOSALS = range(8)


@dataclass(frozen=True)
class Scene:
    """Everything measured at one control step. The world model of planners and checkers."""

    step: int
    qpos: NDArray[np.float64]  # (N, D) rad for the arm, metres for the two fingers, which are the last
    qvel: NDArray[np.float64]  # (N, D)
    poses: Mapping[str, NDArray[np.float64]]  # object -> world_from_object (4, 4)
    speeds: Mapping[str, float]  # object -> linear speed, m/s
    held: tuple[str | None, ...]  # (N,) object pinched between the fingers of each agent
    finger_forces: Mapping[tuple[int, str], NDArray[np.float64]] = field(default_factory=dict)
    # (agent, object) -> (3,) N, with which the fingers of the agent push the object, world frame
    arm_contacts: tuple[tuple[int, int, float], ...] = ()  # (agent, agent, force N)
    seen: NDArray[np.int64] | None = None  # (K, 3) voxels that the depth cameras see occupied, if they looked
    clutter: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    # piece of clutter -> world_from_object (4, 4)
    clutter_contacts: tuple[tuple[str, str, float], ...] = ()  # (agent<k> or object, piece, force N)
    # (N, dof) by which joints are measured beside where they are. Who acts does not know it.
    joint_offset_rad: NDArray[np.float64] | None = None

    @property
    def true(self) -> "Scene":
        """The scene with the joints as they are: what judges see."""
        if self.joint_offset_rad is None:
            return self
        qpos = self.qpos.copy()
        joints_of(qpos)[:] -= self.joint_offset_rad
        return replace(self, qpos=qpos, joint_offset_rad=None)

    @property
    def time_s(self) -> float:
        """Since the start of the episode."""
        return self.step * CONTROL_DT_S


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera: square pixels, principal point in the middle."""

    width_px: int
    height_px: int
    fov_y_rad: float
    world_from_camera: Matrix  # (4, 4), OpenCV axes: x right, y down, z forward

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """(3, 3) pixels from camera coordinates."""
        focal = self.height_px / 2 / np.tan(self.fov_y_rad / 2)
        return np.array([[focal, 0, self.width_px / 2], [0, focal, self.height_px / 2], [0, 0, 1.0]])


@dataclass(frozen=True)
class Calibration:
    """Where arms and cameras stand, as far as that has been measured."""

    world_from_base: tuple[Matrix, ...]  # (4, 4) of each arm
    cameras: Mapping[str, CameraModel]


class World(Protocol):
    """What a rollout and the generation loop need of an environment (given by `rf_exp.sim`)."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera names: `global`, `agent1`, ... `agentN`; empty without rendering."""
        ...

    def reset(self, seed: int) -> Scene: ...

    def step(self, action: NDArray[np.float64]) -> Scene:
        """Apply (N, A) joint targets + gripper command for one control step."""
        ...

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) of the present step; of these cameras, or of all."""
        ...


class SeeingWorld(World, Protocol):
    """A world that can also be measured by its cameras, which the generation loop may ask for."""

    def depth(self) -> dict[str, NDArray[np.float32]]:
        """Camera -> (H, W) metres along the viewing direction at the present step; 0 is nothing."""
        ...

    def camera_models(self) -> dict[str, CameraModel]:
        """Camera -> its model at the present step."""
        ...


# What lies where in the rows that tell of an arm. A row of measured joints (..., D) ends with the two fingers
# in m, a row of a command (..., D - 1) with the gripper, from -1 closed to 1 open. What lies before is of the
# arm, in rad. Robots with fewer joints than another one of their task have zeros behind their own.

FINGERS = 2  # of a hand

Number = TypeVar("Number", bound=np.generic)


def joints_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., D - 2) of the arm, of measured joints (..., D)."""
    return qpos[..., :-FINGERS]


def fingers_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., 2) m from the middle, of measured joints (..., D)."""
    return qpos[..., -FINGERS:]


def arm_of(action: NDArray[Number]) -> NDArray[Number]:
    """(..., A - 1) joint targets of the arm, of commands (..., A)."""
    return action[..., :-1]


def gripper_of(action: NDArray[Number]) -> NDArray[Number]:
    """(...) from -1 closed to 1 open, of commands (..., A)."""
    return action[..., -1]


def narrowed(rows: NDArray[Number], joints: int, hand: int) -> NDArray[Number]:
    """(..., joints + hand) of an arm with so many joints, of rows (..., D) of a task with more."""
    if rows.shape[-1] == joints + hand:
        return rows
    return np.concatenate([rows[..., :joints], rows[..., -hand:]], axis=-1)


# how far a task is done


class Measured(NamedTuple):  # a frozen dataclass takes three times as long, many times a control step
    """A number against its bound; as a condition of success it is as true as `holds`."""

    holds: bool
    value: float
    bound: float
    unit: str
    above: bool  # the value should be above the bound, otherwise below it

    def __bool__(self) -> bool:
        return self.holds

    @property
    def asked(self) -> str:
        return bound_text(self.bound, self.above)


Condition = bool | Measured  # of success
UNITS = ("", "m", "m/s", "deg", "rad", "s", "N", "kg")  # that a `Measured` may have


class Verdict(NamedTuple):  # as above
    """What the success criteria say about one step."""

    success: bool  # strict, held long enough
    success_paper: bool
    evidence: Mapping[str, bool]  # named condition -> holds now
    measured: Mapping[str, Measured] = MappingProxyType({})  # the numbers of those that have one
    lost: Mapping[str, str] = MappingProxyType({})  # object -> dropped | out of reach | off the table


@dataclass(frozen=True)
class Judged:
    """How far each of C conditions of success was met. Row t is what action t has led to."""

    names: tuple[str, ...]
    value: NDArray[np.float32]  # (T, C) 1 or 0 where a condition is a mere yes or no
    bound: NDArray[np.float32]  # (T, C) against which the value is held
    unit: NDArray[np.uint8]  # (T, C) of both, an index of UNITS: a condition may have several sides
    holds: NDArray[np.bool_]  # (T, C)


# what was done: a demonstration, or the rollout of a policy


@dataclass(frozen=True)
class Episode:
    """One executed episode. Row t is observed before action t is applied."""

    task: str
    seed: int
    qpos: NDArray[np.float32]  # (T, N, D) measured
    qvel: NDArray[np.float32]  # (T, N, D)
    action: NDArray[np.float32]  # (T, N, A) joint targets rad + gripper command, as intended
    images: Mapping[str, NDArray[np.uint8]]  # camera -> (T, H, W, 3); empty without rendering
    certificate: Mapping[str, object] = field(default_factory=dict)  # JSON: checks and results, subgoals
    executed: NDArray[np.float32] | None = None  # (T, N, A) what the arms were told; None: `action`
    poses: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    # object -> (T, 7) position in m and quaternion w, x, y, z, world frame
    subgoal: NDArray[np.int16] | None = None  # (T, N) each agent's, an index of certificate["subgoals"]
    judged: Judged | None = None
    extras: Mapping[str, NDArray] = field(default_factory=dict)
    # depth_<camera> -> (T, H, W) u16 mm, segmentation_<camera> -> (T, H, W) u8; those that were asked for

    @property
    def commanded(self) -> NDArray[np.float32]:
        """(T, N, A) what the arms were told: played again from the seed, it gives this episode again."""
        return self.action if self.executed is None else self.executed


@dataclass(frozen=True)
class KeypointDetection:
    """A keypoint in a picture, detected by a policy: where an agent will be, or where another one is."""

    camera: str
    agent: int
    x: float  # to the right, from 0 to 1 over the picture
    y: float  # down
    is_next: bool  # whether it is where this agent goes next


@dataclass(frozen=True)
class RolloutStep:
    """One control step of a rollout, as its observers are told of it."""

    scene: Scene  # after the step
    action: NDArray[np.float64]  # (N, A) as commanded: joint targets rad + gripper command
    predicted: Mapping[int, NDArray[np.float64]]  # agent -> (T, A) targets from this step on
    verdict: Verdict
    violation: Violation | None  # seen by the monitor
    withheld: Mapping[int, str] | None = None  # agent -> why a shield kept its command; None without one
    detections: tuple[KeypointDetection, ...] = ()  # in the pictures that policies looked at last
    # agent -> the number of its subgoal and whether it may go on, as its policy said at its last prediction
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollout:
    """What happened when a policy acted in one scene."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    violations: int  # control steps with a violation, seen by the monitor
    contacts: int  # control steps in which arms touched each other
    account: Account = field(default_factory=Account)  # arms that touched, violations seen, what failed
    interventions: int = 0  # control steps in which a shield kept an agent from its command

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty for a success."""
        return "" if self.success else self.account.reason
