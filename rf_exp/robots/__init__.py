"""Robots without a simulator: each a value, in a folder of its own, and what they have in common."""

from typing import TYPE_CHECKING

from rf_exp.late import late
from rf_exp.robots.arm import Arm
from rf_exp.robots.known import DEFAULT, add_robot, known_robots, robot_named
from rf_exp.robots.robot import Drive, Finger, Hand, Inverse, Robot

if TYPE_CHECKING:
    from rf_exp.robots.meshes import cache_folder, is_made, light_urdf

__getattr__ = late(__name__, {"meshes": ("cache_folder", "is_made", "light_urdf")})

__all__ = [
    "DEFAULT",
    "Arm",
    "Drive",
    "Finger",
    "Hand",
    "Inverse",
    "Robot",
    "add_robot",
    "cache_folder",
    "is_made",
    "known_robots",
    "light_urdf",
    "robot_named",
]
