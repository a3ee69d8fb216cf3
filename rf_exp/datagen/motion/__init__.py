"""Motion: inverse kinematics, primitives, collision-free paths, timing."""

from rf_exp.datagen.motion.disturb import disturb
from rf_exp.datagen.motion.planner import Posture, plan_motion
from rf_exp.datagen.motion.state import Unreachable
from rf_exp.datagen.motion.stop import come_to_rest, let_off

__all__ = ["Posture", "Unreachable", "come_to_rest", "disturb", "let_off", "plan_motion"]
