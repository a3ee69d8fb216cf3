"""ManiSkill agent of a robot, with light visual meshes and absolute joint targets; its joints as rows."""

from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from typing import Any

import numpy as np
import sapien
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers import PDJointPosControllerConfig, PDJointPosMimicControllerConfig
from mani_skill.agents.registration import register_agent
from mani_skill.utils.building.articulation_builder import ArticulationBuilder
from mani_skill.utils.sapien_utils import apply_urdf_config, parse_urdf_config
from mani_skill.utils.structs import Articulation, Pose
from numpy.typing import NDArray
from sapien import physx

from rf_exp.errors import ArgumentError
from rf_exp.robots import Robot, simplified_urdf
from rf_exp.types import FINGERS

Floats = NDArray[np.float64]

GRIP: Any = {"material": "gripper", "patch_radius": 0.1, "min_patch_radius": 0.1}
MATERIAL: Any = {"static_friction": 2.0, "dynamic_friction": 2.0, "restitution": 0.0}

_BUILDERS: dict[tuple[Robot, str], ArticulationBuilder] = {}  # (robot, URDF path) -> parsed URDF


@cache
def uid_of(robot: Robot) -> str:
    """Registers a robot as an agent of ManiSkill; returns its uid."""
    uid = f"rf_{robot.name}"
    fingers = {finger.link: GRIP for finger in robot.hand.fingers}
    attributes = {
        "uid": uid,
        "model": robot,
        "urdf_config": {"_materials": {"gripper": MATERIAL}, "link": fingers},
    }
    register_agent(override=True)(type(uid, (Agent,), attributes))
    return uid


class Agent(BaseAgent):
    """Action: the joint targets of the arm in rad, then the gripper in [-1 closed, 1 open]."""

    model: Robot  # of each subclass
    robot: Any = None  # like the names below set by `_load_articulation`, in ManiSkill's constructor
    robot_link_names: Sequence[str] = ()

    @property
    def urdf_path(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return str(simplified_urdf(self.model))

    def _load_articulation(self, initial_pose: sapien.Pose | Pose | None = None) -> None:
        """ManiSkill's method, but each process parses the URDF only once: parsing is a third of a reset."""
        key = self.model, self.urdf_path
        if (builder := _BUILDERS.get(key)) is None:
            loader = self.scene.create_urdf_loader()
            loader.fix_root_link = self.fix_root_link
            loader.disable_self_collisions = self.disable_self_collisions
            loader.load_multiple_collisions_from_file = self.load_multiple_collisions
            config: Any = self.urdf_config  # ManiSkill annotates it as a string
            apply_urdf_config(loader, parse_urdf_config(config))
            (builder,) = loader.parse(self.urdf_path)["articulation_builders"]
            _BUILDERS[key] = builder
        builder.set_scene(self.scene)  # pyright: ignore[reportArgumentType]
        builder.set_scene_idxs(None).set_name(f"{self.uid}-agent-{self._agent_idx}")
        builder.initial_pose = initial_pose
        try:
            self.robot = builder.build()
        finally:
            builder.set_scene(None)  # pyright: ignore[reportArgumentType] # or it would keep it alive
        self.robot_link_names = [link.name for link in self.robot.get_links()]

    @property
    def _controller_configs(self) -> dict:
        hand = self.model.hand
        joints = [joint for finger in hand.fingers for joint in finger.joints]
        arm_joints, drive = [*self.model.joints], asdict(self.model.drive)
        arm = PDJointPosControllerConfig(arm_joints, None, None, normalize_action=False, **drive)
        low, high = sorted(hand.fingers[0].position(opening_m) for opening_m in (hand.pressed_m, hand.open_m))
        mimic: Any = {joint: {"joint": joints[0]} for joint in joints[1:]}
        gripper = PDJointPosMimicControllerConfig(
            joints, lower=low, upper=high, mimic=mimic, **asdict(hand.drive)
        )
        return {"pd_joint_pos": {"arm": arm, "gripper": gripper}}


class JointInterface:
    """Converter between the joints of an arm in SAPIEN's order and the suite's joint vectors (rows).

    Rows of measured joints have length `size`. Raises ArgumentError for joints that belong neither to the
    arm nor to a finger, and for fingers without a joint.
    """

    def __init__(self, robot: Robot, articulation: Articulation, size: int) -> None:
        self._robot, self._size = robot, size
        self.arm: physx.PhysxArticulation = articulation._objs[0]
        self._joints = self.arm.active_joints
        # The names in SAPIEN itself have the scene's and the agent's name as a prefix.
        names, fingers = [joint.name for joint in articulation.active_joints], robot.hand.fingers
        if {*names} != {*robot.active_joints} or not all(finger.joints for finger in fingers):
            raise ArgumentError(
                f"robot {robot.name!r} has the joints {', '.join(names)} in simulation; expected those of "
                f"its arm and of two fingers: {', '.join(robot.active_joints)}"
            )
        self._qpos_indices = [names.index(joint) for joint in robot.qpos_names]
        self._closed = np.array([finger.closed for finger in fingers])
        self._per_m = np.array([finger.per_m for finger in fingers])
        columns = {joint: column for column, joint in enumerate(robot.joints)}
        columns |= {joint: k - FINGERS for k, finger in enumerate(fingers) for joint in finger.joints}
        self._active_columns = [columns[name] for name in names]

    def qpos(self) -> Floats:
        """(D,) joint positions in rad, fingers in metres."""
        row = self._qpos_row(self.arm.qpos)
        row[-FINGERS:] = (row[-FINGERS:] - self._closed) / self._per_m
        return row

    def qvel(self) -> Floats:
        """(D,) joint velocities in rad/s, fingers in m/s."""
        row = self._qpos_row(self.arm.qvel)
        row[-FINGERS:] /= self._per_m
        return row

    def place(self, row: Floats) -> None:
        """Sets the joints to a row (D,) of positions."""
        self.arm.set_qpos(self._active_positions(row).astype(np.float32))

    def drive(self, row: Floats) -> None:
        """Sets the drive targets to a row (D,) of positions."""
        for joint, value in zip(self._joints, self._active_positions(row).tolist(), strict=True):
            joint.set_drive_target(value)

    def command(self, command: Floats) -> None:
        """Sets the drive targets from a command (D - 1,)."""
        finger_m = self._robot.hand.finger_target_m(command[-1])
        self.drive(np.concatenate([command[:-1], [finger_m, finger_m]]))

    def _active_positions(self, row: Floats) -> Floats:
        """All active joints, in SAPIEN's order, from a row (D,) of the arm's joints and the fingers."""
        positions = row.copy()
        positions[-FINGERS:] = self._closed + self._per_m * row[-FINGERS:]
        return positions[self._active_columns]

    def _qpos_row(self, values: NDArray[np.floating]) -> Floats:
        row, dof = np.zeros(self._size), self._robot.dof
        measured = values[self._qpos_indices]
        row[:dof], row[-FINGERS:] = measured[:dof], measured[dof:]
        return row
