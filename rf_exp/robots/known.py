"""The robots that tasks may name, by the values of their `model`: these, and those that are added."""

import numpy as np

from rf_exp.errors import ArgumentError, choices
from rf_exp.robots.closed_form import ClosedForm, XArm7ClosedForm
from rf_exp.robots.mounted import Mounted
from rf_exp.robots.robot import Finger, Hand, Robot
from rf_exp.robots.ur import UR5ClosedForm

PANDA_URDF = "package://mani_skill/assets/robots/panda/panda_v2.urdf"
ASKEW_RAD = (0.0, 0.0, -np.pi / 4)  # as the hand sits on the Panda

# The Franka Emika Panda with its two-finger hand: URDF and meshes are those of ManiSkill's package.
PANDA = Robot(
    name="panda",
    title="Franka Panda with its gripper",
    kind="franka_panda",
    urdf=PANDA_URDF,
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
# UFACTORY's xArm7, also of ManiSkill's package, with the Panda's hand.
XARM7 = Robot(
    name="xarm7",
    title="xArm7 with the Panda's gripper",
    urdf=Mounted(
        "package://mani_skill/assets/robots/xarm7/xarm7.urdf", "link7", PANDA_URDF, "panda_hand", ASKEW_RAD
    ),
    joints=tuple(f"joint{k}" for k in range(1, 8)),
    hand=PANDA.hand,
    rest_rad=(0.0, 0.3456, 0.0, 1.2383, 0.0, 0.8927, np.pi / 4),
    aside_rad=(0.0, -0.6, 0.0, np.pi - 2.5, 0.0, np.pi - 1.9, np.pi / 4),
    reach_m=0.78,  # at the table its TCP reaches so much less far than the Panda's
    swivel=2,
    inverse=XArm7ClosedForm,
)
# Universal Robots' UR5 of example-robot-data, with the Panda's hand.
_UR = "distribution://example-robot-data/cmeel.prefix/share/example-robot-data/robots/ur_description/urdf"
UR5 = Robot(
    name="ur5",
    title="UR5 with the Panda's gripper",
    urdf=Mounted(
        f"{_UR}/ur5_robot.urdf",
        "tool0",
        PANDA_URDF,
        "panda_hand",
        (0.0, 0.0, -np.pi / 2),
        without=("world", "base", "ee_link"),
        extra="ur5",
    ),
    joints=tuple(
        f"{name}_joint"
        for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    ),
    hand=PANDA.hand,
    rest_rad=(-0.245, -1.6392, 1.9702, -1.9018, -np.pi / 2, -0.245),
    aside_rad=(-0.3724, -2.0786, 2.0144, -1.5066, -np.pi / 2, -0.3724),
    reach_m=0.85,  # its data sheet
    inverse=UR5ClosedForm,
)
DEFAULT = PANDA  # of a task that names none, and of data from before they said
_KNOWN = {robot.name: robot for robot in (PANDA, XARM7, UR5)}


def add_robot(robot: Robot) -> None:
    """Lets tasks name a robot. Raises ArgumentError for the name of another one."""
    known = _KNOWN.setdefault(robot.name, robot)
    if known != robot:
        raise ArgumentError(f"there is another robot called {robot.name!r}; call it otherwise")


def robot_named(name: str) -> Robot:
    """Raises ArgumentError for a name that nobody has added."""
    if name not in _KNOWN:
        raise choices("robot model", name, _KNOWN)
    return _KNOWN[name]


def known_robots() -> tuple[Robot, ...]:
    """All of them, in the order in which they were added."""
    return tuple(_KNOWN.values())
