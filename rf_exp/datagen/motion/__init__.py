"""Motion: inverse kinematics, primitives, collision-free paths, timing."""

from rf_exp.datagen.motion.destination import destinations
from rf_exp.datagen.motion.disturb import disturb
from rf_exp.datagen.motion.planner import Handover, Motions, plan_motion
from rf_exp.datagen.motion.queues import in_turn
from rf_exp.datagen.motion.request import Request
from rf_exp.datagen.motion.state import Blockage, Blocked, Obstacle, State, Unreachable, name_of
from rf_exp.datagen.motion.stop import as_commanded, come_to_rest, let_off
from rf_exp.datagen.motion.verbs import Motion, add_primitive

__all__ = [
    "Blockage",
    "Blocked",
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
    "destinations",
    "disturb",
    "in_turn",
    "let_off",
    "name_of",
    "plan_motion",
]
