"""Motion: inverse kinematics, primitives, collision-free paths, timing."""

from rf_exp.datagen.motion.disturb import disturb
from rf_exp.datagen.motion.planner import Posture, plan_motion
from rf_exp.datagen.motion.state import Blocked, Obstacle, State, Unreachable
from rf_exp.datagen.motion.stop import come_to_rest, let_off
from rf_exp.datagen.motion.verbs import Motion, Request, add_primitive

__all__ = [
    "Blocked",
    "Motion",
    "Obstacle",
    "Posture",
    "Request",
    "State",
    "Unreachable",
    "add_primitive",
    "come_to_rest",
    "disturb",
    "let_off",
    "plan_motion",
]
