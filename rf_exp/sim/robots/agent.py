"""A robot as ManiSkill loads it: its URDF with light visual meshes, and absolute joint targets."""

from functools import cache
from typing import Any

from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers import PDJointPosControllerConfig, PDJointPosMimicControllerConfig
from mani_skill.agents.registration import register_agent

from rf_exp.robots import Drive, Robot, light_urdf

GRIP: Any = {"material": "gripper", "patch_radius": 0.1, "min_patch_radius": 0.1}
MATERIAL: Any = {"static_friction": 2.0, "dynamic_friction": 2.0, "restitution": 0.0}


@cache
def uid_of(robot: Robot) -> str:
    """ManiSkill's name of a robot, by which it finds it from now on."""
    uid = f"rf_{robot.name}"
    fingers = {finger.link: GRIP for finger in robot.hand.fingers}
    said = {"uid": uid, "model": robot, "urdf_config": {"_materials": {"gripper": MATERIAL}, "link": fingers}}
    register_agent(override=True)(type(uid, (Agent,), said))
    return uid


class Agent(BaseAgent):
    """Action: the joint targets of the arm in rad, then the gripper in [-1 closed, 1 open]."""

    model: Robot  # of each subclass

    @property
    def urdf_path(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return str(light_urdf(self.model))

    @property
    def _controller_configs(self) -> dict:
        hand = self.model.hand
        joints = [joint for finger in hand.fingers for joint in finger.joints]
        arm = PDJointPosControllerConfig(
            list(self.model.joints),
            lower=None,
            upper=None,
            normalize_action=False,
            **_driven(self.model.drive),
        )
        low, high = sorted(hand.fingers[0].position(each) for each in (hand.pressed_m, hand.open_m))
        mimic: Any = {joint: {"joint": joints[0]} for joint in joints[1:]}
        gripper = PDJointPosMimicControllerConfig(
            joints, lower=low, upper=high, mimic=mimic, **_driven(hand.drive)
        )
        return {"pd_joint_pos": {"arm": arm, "gripper": gripper}}


def _driven(drive: Drive) -> dict[str, Any]:
    return {"stiffness": drive.stiffness, "damping": drive.damping, "force_limit": drive.force_limit}
