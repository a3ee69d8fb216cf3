"""What is measured at one control step, and the world that it is measured in."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.transforms import Matrix

CONTROL_HZ = 20
CONTROL_DT_S = 1.0 / CONTROL_HZ
ARM_JOINTS = 7  # that policies take; everybody else asks the robots of a task
GRIPPER_OPEN, GRIPPER_CLOSED = 1.0, -1.0  # gripper command, ManiSkill's normalised width


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
