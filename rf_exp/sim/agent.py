"""ManiSkill's Panda with light visual meshes and absolute joint targets; all else is stock."""

from typing import Any

from mani_skill.agents.controllers import PDJointPosControllerConfig, PDJointPosMimicControllerConfig
from mani_skill.agents.registration import register_agent
from mani_skill.agents.robots.panda import Panda

from rf_exp.robots import light_urdf

UID = "rf_panda"
GRIPPER_M = (-0.01, 0.04)  # finger position at commands -1 and 1; below 0 presses on thin things


@register_agent()
class LightPanda(Panda):
    """Action: 7 joint targets in rad, then the gripper in [-1 closed, 1 open]."""

    uid = UID

    @property
    def urdf_path(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return str(light_urdf())

    @property
    def _controller_configs(self) -> dict:
        arm = PDJointPosControllerConfig(
            self.arm_joint_names,
            lower=None,
            upper=None,
            stiffness=self.arm_stiffness,
            damping=self.arm_damping,
            force_limit=self.arm_force_limit,
            normalize_action=False,
        )
        mimic: Any = {"panda_finger_joint2": {"joint": "panda_finger_joint1"}}
        gripper = PDJointPosMimicControllerConfig(
            self.gripper_joint_names,
            lower=GRIPPER_M[0],
            upper=GRIPPER_M[1],
            stiffness=self.gripper_stiffness,
            damping=self.gripper_damping,
            force_limit=self.gripper_force_limit,
            mimic=mimic,
        )
        return {"pd_joint_pos": {"arm": arm, "gripper": gripper}}
