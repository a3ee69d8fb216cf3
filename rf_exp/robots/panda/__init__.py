"""The Franka Emika Panda with its two-finger hand: URDF and meshes are those of ManiSkill's package."""

import numpy as np

from rf_exp.robots.panda.closed_form import ClosedForm
from rf_exp.robots.robot import Finger, Hand, Robot

__all__ = ["PANDA"]

PANDA = Robot(
    name="panda",
    title="Franka Panda with its gripper",
    kind="franka_panda",
    urdf="package://mani_skill/assets/robots/panda/panda_v2.urdf",
    joints=tuple(f"panda_joint{k}" for k in range(1, 8)),
    hand=Hand(
        link="panda_hand",
        tcp="panda_hand_tcp",
        fingers=(
            Finger("panda_leftfinger", ("panda_finger_joint1",), opens=(0.0, 1.0, 0.0)),
            Finger("panda_rightfinger", ("panda_finger_joint2",), opens=(0.0, -1.0, 0.0)),
        ),
        open_m=0.04,
        pressed_m=-0.01,
    ),
    rest_rad=(0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4),
    aside_rad=(0.0, -0.6, 0.0, -2.5, 0.0, 1.9, np.pi / 4),
    reach_m=0.855,  # its data sheet
    swivel=2,
    reflex_n=20.0,  # its collision reflex in its maker's examples
    inverse=ClosedForm,
)
