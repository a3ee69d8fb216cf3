"""The robots that tasks may name, by the values of their `model`: the Panda, and those that are added."""

import numpy as np

from rf_exp.errors import ArgumentError, choices
from rf_exp.robots.closed_form import ClosedForm
from rf_exp.robots.robot import Finger, Hand, Robot

# The Franka Emika Panda with its two-finger hand: URDF and meshes are those of ManiSkill's package.
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
DEFAULT = PANDA  # of a task that names none, and of data from before they said
_KNOWN = {DEFAULT.name: DEFAULT}


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
