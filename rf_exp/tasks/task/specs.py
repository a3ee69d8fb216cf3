"""Specifications in a task's configuration, as frozen values; size of the table, the same for all tasks."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT, Robot
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix, from_axes, planar, rotation_matrix
from rf_exp.types import FINGERS, CameraModel

SMALLEST, LARGEST = 0.5, 1.5  # scales of objects
TABLE_M = (2.6, 2.8, 0.06)  # extents along x, y, z; the top is at z = 0
TABLE_CENTRE_M = (0.1, 0.0)


def beyond_edge(points: NDArray[np.float64]) -> tuple[float, str]:
    """How far (m) points (K, 2 or 3) extend beyond an edge at most, and which edge; 0 or less: not at all."""
    half, centre = np.array(TABLE_M[:2]) / 2, np.array(TABLE_CENTRE_M)
    ends = np.stack([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])  # (2, 2) lowest and highest
    edges = np.stack([centre - half, centre + half])
    beyond = (ends - edges) * np.array([[-1.0], [1.0]])
    side, axis = (int(index) for index in np.unravel_index(beyond.argmax(), beyond.shape))
    return float(beyond[side, axis]), f"{'xy'[axis]} = {edges[side, axis]:g} m"


@dataclass(frozen=True)
class RobotSpec:
    """A robot bolted to the table: model, base pose and rest posture."""

    x_m: float
    y_m: float
    yaw_deg: float
    rest_rad: tuple[float, ...] = ()  # (dof,); by default that of the robot
    model: Robot = DEFAULT
    z_m: float = 0.0  # of the base above the table top

    def __post_init__(self) -> None:
        rest_rad, joints = self.rest_rad or self.model.rest_rad, self.model.dof
        object.__setattr__(self, "rest_rad", tuple(map(float, rest_rad)))
        if len(self.rest_rad) != joints:
            raise ArgumentError(f"rest_rad has {len(self.rest_rad)} values; an arm has {joints} joints")

    @property
    def rest_qpos(self) -> NDArray[np.float64]:
        """(D,) joints at rest in rad, then open fingers in m."""
        return np.array([*self.rest_rad, *[self.model.hand.open_m] * FINGERS])

    @cached_property
    def world_from_base(self) -> Matrix:
        return planar(self.x_m, self.y_m, np.deg2rad(self.yaw_deg), self.z_m)

    @property
    def mounted(self) -> Asset | None:
        """Collision geometry mounted on the gripper, in the frame of its link; None: nothing."""
        return None

    @property
    def identity(self) -> dict[str, Any]:
        """Part of the task's identity: placement and model. Default values are left out."""
        values = {"x_m": self.x_m, "y_m": self.y_m, "yaw_deg": self.yaw_deg, "rest_rad": self.rest_rad}
        values |= {"z_m": self.z_m} if self.z_m else {}
        return values if self.model == DEFAULT else {**values, "model": self.model.identity}


@dataclass(frozen=True)
class ObjectSpec:
    """An object and the ranges of its start pose, uniform on each axis."""

    asset: str
    x_m: tuple[float, float] = (0.0, 0.0)
    y_m: tuple[float, float] = (0.0, 0.0)
    z_m: float = 0.0
    yaw_deg: tuple[float, float] = (0.0, 0.0)
    relative_to: str | None = None  # another object: x, y, yaw count from its pose, z from its origin
    options: Mapping[str, Any] = field(default_factory=dict)  # of the asset's `build`, e.g. its colour
    size: float = 1.0  # scale of the asset
    open_deg: float = 0.0  # start angle of a hinged object, which hangs on `relative_to`

    def __post_init__(self) -> None:
        for axis in ("x_m", "y_m", "yaw_deg"):
            value = getattr(self, axis)
            low, high = value if isinstance(value, list | tuple) else (value, value)
            if low > high:
                raise ArgumentError(
                    f"{axis} of asset {self.asset!r}: range [{low}, {high}] is the wrong way round; "
                    f"write [{high}, {low}]"
                )
            object.__setattr__(self, axis, (float(low), float(high)))
        if not SMALLEST <= self.size <= LARGEST:
            raise ArgumentError(
                f"size of asset {self.asset!r} is {self.size}; expected {SMALLEST} to {LARGEST}"
            )

    @cached_property
    def nominal(self) -> Matrix:
        """(4, 4) pose in the middle of the ranges, in the frame that they are relative to."""
        x_m, y_m, yaw_deg = (sum(ends) / 2 for ends in (self.x_m, self.y_m, self.yaw_deg))
        return planar(x_m, y_m, np.deg2rad(yaw_deg), self.z_m)

    @property
    def stands_on(self) -> str | None:
        """The object that bears it and has the same scale; None: the table."""
        return self.relative_to if self.z_m else None

    def scaled(self, size: float) -> "ObjectSpec":
        """The object scaled by `size`, with its offsets from the object that bears it."""
        if size == 1:
            return self
        spec = replace(self, size=size * self.size)
        if self.stands_on is None:
            return spec
        x_m, y_m = (tuple(size * value for value in ends) for ends in (self.x_m, self.y_m))
        return replace(spec, x_m=x_m, y_m=y_m, z_m=size * self.z_m)


@dataclass(frozen=True)
class CameraMotion:
    """Change of a camera against its specification."""

    shift_m: tuple[float, float, float]  # world frame
    turn_deg: tuple[float, float, float]  # rotation vector, in the camera's frame
    fov_deg: float


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole camera, fixed in the world or, with `mount: wrist`, eye in hand on its agent."""

    eye_m: tuple[float, float, float] = (0.0, 0.0, 1.0)
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov_deg: float = 90.0  # vertical
    mount: str = "world"  # world | wrist
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector off the target, camera frame

    def __post_init__(self) -> None:
        if self.mount not in ("world", "wrist"):
            raise ArgumentError(f"camera mount {self.mount!r}; available: world, wrist")
        for name in ("eye_m", "target_m", "turn_deg"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @cached_property
    def world_from_camera(self) -> Matrix:
        """(4, 4) pose of a world camera: x right, y down, z forward (OpenCV)."""
        forward = np.subtract(self.target_m, self.eye_m)
        upright = (0, 0, -1) if np.hypot(*forward[:2]) > 1e-6 else (-1, 0, 0)  # straight down: +x is up
        return from_axes(self.eye_m, z=forward, y=upright) @ rotation_matrix(np.deg2rad(self.turn_deg))

    def model(self, pose: Matrix, size_px: tuple[int, int]) -> CameraModel:
        """The camera model for a (width, height) and a world pose (4, 4)."""
        return CameraModel(*size_px, float(np.deg2rad(self.fov_deg)), pose)

    def moved(self, motion: CameraMotion) -> "CameraSpec":
        """The camera shifted and turned; a wrist camera changes its field of view only."""
        fov_deg = self.fov_deg + motion.fov_deg
        if self.mount == "wrist":
            return replace(self, fov_deg=fov_deg)
        eye, target = (tuple(np.add(point, motion.shift_m).tolist()) for point in (self.eye_m, self.target_m))
        return replace(self, eye_m=eye, target_m=target, fov_deg=fov_deg, turn_deg=motion.turn_deg)

    @property
    def identity(self) -> dict[str, Any]:
        """Part of the task's identity: all that determines its pictures. A zero `turn_deg` is left out."""
        return {key: value for key, value in asdict(self).items() if key != "turn_deg" or any(value)}


class Thresholds(dict[str, float]):
    """Thresholds of a task's success, units in their names. Raises ArgumentError for a missing one."""

    def __missing__(self, name: str) -> float:
        raise ArgumentError(
            f"the task's module reads success.{name}, which its file does not have; it has {', '.join(self)}"
        )


@dataclass(frozen=True)
class Randomisation:
    """Randomisation of rest posture, light, colours and masses, drawn from the episode's seed."""

    init_qpos_std_rad: float  # standard deviation of each joint
    light: float  # half range of the relative brightness
    colour: float  # half range of the relative brightness of each primary colour of each object
    mass_scale: float  # masses are uniform from `mass_kg` to this fraction of the way to `heaviest_kg`

    def __post_init__(self) -> None:
        if not 0 <= self.init_qpos_std_rad < np.inf:
            raise ArgumentError(
                f"randomisation.init_qpos_std_rad is {self.init_qpos_std_rad}; expected 0 or more"
            )
        for name in ("light", "colour", "mass_scale"):
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ArgumentError(f"randomisation.{name} is {value}; expected a number from 0 to 1")
