"""Robots without a simulator: each a value, in a folder of its own, and what they have in common."""

from rf_exp.robots.arm import Arm
from rf_exp.robots.known import DEFAULT, add_robot, known_robots, robot_named
from rf_exp.robots.robot import Drive, Finger, Hand, Inverse, Robot

__all__ = [
    "DEFAULT",
    "Arm",
    "Drive",
    "Finger",
    "Hand",
    "Inverse",
    "Robot",
    "add_robot",
    "known_robots",
    "robot_named",
]
