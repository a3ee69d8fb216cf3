"""Motion: inverse kinematics, primitives, collision-free paths, timing."""

from rf_exp.datagen.motion.destination import destinations
from rf_exp.datagen.motion.disturb import ADDED, TALLEST, Disturbance
from rf_exp.datagen.motion.planner import Handover, Motions, plan_motion
from rf_exp.datagen.motion.queues import in_turn
from rf_exp.datagen.motion.request import Request
from rf_exp.datagen.motion.state import Blockage, Blocked, Obstacle, State, Unreachable, name_of
from rf_exp.datagen.motion.stop import as_commanded, come_to_rest, come_to_rest_disturbed, let_off
from rf_exp.datagen.motion.verbs import Motion, add_primitive

__all__ = [
    "ADDED",
    "TALLEST",
    "Blockage",
    "Blocked",
    "Disturbance",
    "Handover",
    "Motion",
    "Motions",
    "Obstacle",
    "Request",
    "State",
    "Unreachable",
    "add_primitive",
    "as_commanded",
    "come_to_rest",
    "come_to_rest_disturbed",
    "destinations",
    "in_turn",
    "let_off",
    "name_of",
    "plan_motion",
]
