"""Motion: inverse kinematics, primitives, collision-free paths, timing."""

from rf_exp.datagen.motion.planner import Posture, plan_motion
from rf_exp.datagen.motion.state import Unreachable

__all__ = ["Posture", "Unreachable", "plan_motion"]
