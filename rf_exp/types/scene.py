"""Measured scene of a control step, its verdict by the success criteria, episodes and rollouts."""

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
ARM_JOINTS = 7  # of arms that policies support; all other code asks the robots of a task
GRIPPER_OPEN, GRIPPER_CLOSED = 1.0, -1.0  # gripper command, ManiSkill's normalised width

# Random streams of an episode: `default_rng([seed, STREAM, ...])`, one for each purpose; faults of a brain
# share the stream of disturbances. NumPy pads a seed with zeros, so `[seed, STREAM]` and `[seed, STREAM, 0]`
# are the same stream: where the former is in use, further numbers begin at 1.
SCENE, PLANNING, DISTURBANCES, CORRECTION, PIXELS, FLICKER, VARIATION, PROPOSALS = range(8)


@dataclass(frozen=True)
class Scene:
    """All measurements of one control step. The world model of planners and checkers."""

    step: int
    qpos: NDArray[np.float64]  # (N, D) rad for the arm, metres for the two fingers, which are the last
    qvel: NDArray[np.float64]  # (N, D)
    poses: Mapping[str, NDArray[np.float64]]  # object -> world_from_object (4, 4)
    speeds: Mapping[str, float]  # object -> linear speed, m/s
    held: tuple[str | None, ...]  # (N,) object pinched between the fingers of each agent
    finger_forces: Mapping[tuple[int, str], NDArray[np.float64]] = field(default_factory=dict)
    # (agent, object) -> (3,) N force of the agent's fingers on the object, world frame
    arm_contacts: tuple[tuple[int, int, float], ...] = ()  # (agent, agent, force N)
    occupied_voxels: NDArray[np.int64] | None = None
    # (K, 3) voxels occupied in depth pictures; None: not measured
    clutter: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    # piece of clutter -> world_from_object (4, 4)
    clutter_contacts: tuple[tuple[str, str, float], ...] = ()  # (agent<k> or object, piece, force N)
    # (N, dof) measured less true joint positions; unknown to planners and policies
    joint_offset_rad: NDArray[np.float64] | None = None

    @property
    def with_true_joints(self) -> "Scene":
        """The scene with the true joint positions, for judging success and contacts."""
        if self.joint_offset_rad is None:
            return self
        qpos = self.qpos.copy()
        joints_of(qpos)[:] -= self.joint_offset_rad
        return replace(self, qpos=qpos, joint_offset_rad=None)

    @property
    def time_s(self) -> float:
        """Time since the start of the episode."""
        return self.step * CONTROL_DT_S


@dataclass(frozen=True)
class CameraModel:
    """Pinhole camera: square pixels, principal point in the centre."""

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
    """Calibrated poses of arm bases and cameras, as far as they have been measured."""

    world_from_base: tuple[Matrix, ...]  # (4, 4) of each arm
    cameras: Mapping[str, CameraModel]


class World(Protocol):
    """Environment as rollouts and the generation loop need it (implemented by `rf_exp.sim`)."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera names: `global`, `agent1`, ... `agentN`; empty without rendering."""
        ...

    def reset(self, seed: int) -> Scene: ...

    def step(self, action: NDArray[np.float64]) -> Scene:
        """Apply (N, A) joint targets + gripper command for one control step."""
        ...

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) of the present step; None: of all cameras."""
        ...


class SeeingWorld(World, Protocol):
    """World that its cameras can also measure, which the generation loop may require."""

    def depth(self) -> dict[str, NDArray[np.float32]]:
        """Camera -> (H, W) metres along the viewing direction at the present step; 0 for no surface."""
        ...

    def camera_models(self) -> dict[str, CameraModel]:
        """Camera -> its model at the present step."""
        ...


# Layout of the rows of an arm. A row of measured joints (..., D) ends with the two fingers in m, a row of a
# command (..., D - 1) with the gripper, from -1 closed to 1 open. Before these are the arm joints in rad,
# padded with zeros for robots with fewer joints than another one of their task.

FINGERS = 2  # of a gripper

Number = TypeVar("Number", bound=np.generic)


def joints_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., D - 2) arm joints of measured joints (..., D)."""
    return qpos[..., :-FINGERS]


def fingers_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., 2) finger positions, m from the centre, of measured joints (..., D)."""
    return qpos[..., -FINGERS:]


def arm_of(action: NDArray[Number]) -> NDArray[Number]:
    """(..., A - 1) joint targets of commands (..., A)."""
    return action[..., :-1]


def gripper_of(action: NDArray[Number]) -> NDArray[Number]:
    """(...) gripper of commands (..., A), from -1 closed to 1 open."""
    return action[..., -1]


def without_padding(rows: NDArray[Number], n_joints: int, n_gripper: int) -> NDArray[Number]:
    """(..., n_joints + n_gripper) rows of one arm without the padding of its task's rows (..., D)."""
    if rows.shape[-1] == n_joints + n_gripper:
        return rows
    return np.concatenate([rows[..., :n_joints], rows[..., -n_gripper:]], axis=-1)


# progress of a task


class Measured(NamedTuple):  # created many times a control step; a frozen dataclass takes three times as long
    """Number with its bound; as a condition of success it has the truth value of `holds`."""

    holds: bool
    value: float
    bound: float
    unit: str
    above: bool  # the value should be above the bound, otherwise below it

    def __bool__(self) -> bool:
        return self.holds

    @property
    def requirement(self) -> str:
        return bound_text(self.bound, self.above)


Condition = bool | Measured  # of success
UNITS = ("", "m", "m/s", "deg", "rad", "s", "N", "kg")  # possible units of a `Measured`


class Verdict(NamedTuple):  # for speed, as above
    """Verdict of the success criteria on one step."""

    success: bool  # strict criterion, held long enough
    success_paper: bool
    evidence: Mapping[str, bool]  # named condition -> holds now
    measured: Mapping[str, Measured] = MappingProxyType({})  # conditions with a number
    lost: Mapping[str, str] = MappingProxyType({})  # object -> dropped | out of reach | off the table


@dataclass(frozen=True)
class Judged:
    """Values of C conditions of success over an episode. Row t is the result of action t."""

    names: tuple[str, ...]
    value: NDArray[np.float32]  # (T, C) 1 or 0 for a condition without a number
    bound: NDArray[np.float32]  # (T, C) of the value
    unit: NDArray[np.uint8]  # (T, C) of both, an index into UNITS; may vary if a condition has several parts
    holds: NDArray[np.bool_]  # (T, C)


# executed episodes: demonstrations, and rollouts of policies


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
    executed: NDArray[np.float32] | None = None  # (T, N, A) commands sent to the arms; None: `action`
    poses: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    # object -> (T, 7) position in m and quaternion w, x, y, z, world frame
    subgoal: NDArray[np.int16] | None = None  # (T, N) index into certificate["subgoals"]
    judged: Judged | None = None
    extras: Mapping[str, NDArray] = field(default_factory=dict)
    # depth_<camera> -> (T, H, W) u16 mm, segmentation_<camera> -> (T, H, W) u8; as requested

    @property
    def commanded(self) -> NDArray[np.float32]:
        """(T, N, A) commands sent to the arms; replayed from the seed, they reproduce the episode."""
        return self.action if self.executed is None else self.executed


@dataclass(frozen=True)
class KeypointDetection:
    """Keypoint that a policy detected in a picture: a future place of an agent, or another agent's place."""

    camera: str
    agent: int
    x: float  # to the right, from 0 to 1 over the picture
    y: float  # down, likewise
    is_next: bool  # whether the agent goes there next


@dataclass(frozen=True)
class RolloutStep:
    """One control step of a rollout, as passed to its observers."""

    scene: Scene  # after the step
    action: NDArray[np.float64]  # (N, A) as commanded: joint targets rad + gripper command
    predicted: Mapping[int, NDArray[np.float64]]  # agent -> (T, A) targets from this step on
    verdict: Verdict
    violation: Violation | None  # found by the monitor
    withheld: Mapping[int, str] | None = None  # agent -> why the shield withheld its command; None: no shield
    detections: tuple[KeypointDetection, ...] = ()  # in the pictures of the last prediction
    # agent -> (index of its subgoal, whether it may go on), by the last prediction of its policy
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollout:
    """Outcome of a policy in one scene."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    violations: int  # control steps with a violation, found by the monitor
    contacts: int  # control steps in which arms touched each other
    account: Account = field(default_factory=Account)  # contacts, violations, unmet conditions
    interventions: int = 0  # control steps in which the shield withheld a command

    @property
    def reason(self) -> str:
        """Reason for a failure, in words; empty for a success."""
        return "" if self.success else self.account.reason
