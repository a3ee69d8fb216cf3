"""Registry of the robots that tasks may name by `model`: those of the package, and added ones."""

import numpy as np

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.robots.closed_form import ClosedForm, XArm7ClosedForm
from rf_exp.robots.mounted import Mounted
from rf_exp.robots.robot import Finger, Hand, Robot
from rf_exp.robots.ur import UR5ClosedForm

PANDA_URDF = "package://mani_skill/assets/robots/panda/panda_v2.urdf"
HAND_MOUNT_RAD = (0.0, 0.0, -np.pi / 4)  # of the gripper at the Panda's flange

# Franka Emika Panda with its two-finger gripper; URDF and meshes from ManiSkill's package.
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
    reach_m=0.855,  # data sheet
    swivel=2,
    reflex_n=20.0,  # collision reflex in the manufacturer's examples
    inverse=ClosedForm,
)
# UFACTORY xArm7, also from ManiSkill's package, with the Panda's gripper.
XARM7 = Robot(
    name="xarm7",
    title="xArm7 with the Panda's gripper",
    urdf=Mounted(
        "package://mani_skill/assets/robots/xarm7/xarm7.urdf",
        "link7",
        PANDA_URDF,
        "panda_hand",
        HAND_MOUNT_RAD,
    ),
    joints=tuple(f"joint{k}" for k in range(1, 8)),
    hand=PANDA.hand,
    rest_rad=(0.0, 0.3456, 0.0, 1.2383, 0.0, 0.8927, np.pi / 4),
    aside_rad=(0.0, -0.6, 0.0, np.pi - 2.5, 0.0, np.pi - 1.9, np.pi / 4),
    reach_m=0.78,  # shorter than the Panda's by their difference in reach of the TCP at the table
    swivel=2,
    inverse=XArm7ClosedForm,
)
# Universal Robots UR5 from example-robot-data, with the Panda's gripper.
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
    reach_m=0.85,  # data sheet
    inverse=UR5ClosedForm,
)
DEFAULT = PANDA  # for tasks that name none, and for data without a robot, from earlier versions
_ROBOTS = {robot.name: robot for robot in (PANDA, XARM7, UR5)}


def add_robot(robot: Robot) -> None:
    """Registers a robot for tasks. Raises ArgumentError for the name of another robot."""
    registered = _ROBOTS.setdefault(robot.name, robot)
    if registered != robot:
        raise ArgumentError(f"there is another robot called {robot.name!r}; call it otherwise")


def robot_named(name: str) -> Robot:
    """The robot with a name. Raises ArgumentError for an unknown name."""
    if name not in _ROBOTS:
        raise unknown_choice("robot model", name, _ROBOTS)
    return _ROBOTS[name]


def known_robots() -> tuple[Robot, ...]:
    """All registered robots, in the order in which they were added."""
    return tuple(_ROBOTS.values())
