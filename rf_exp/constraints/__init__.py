"""Compositional constraints: interfaces (logical, spatial, temporal) and RoboChecker.

Geometry and time only: no simulator, no learning. Start at `checker`.
"""

from rf_exp.constraints.checked import CheckedPlan
from rf_exp.constraints.checker import CheckCode, RoboChecker, compile
from rf_exp.constraints.compile import check_of
from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.limits import slowed
from rf_exp.constraints.monitor import Monitor
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.spatial import PolicyMonitor

__all__ = [
    "Check",
    "CheckCode",
    "CheckedPlan",
    "Evidence",
    "Monitor",
    "Paths",
    "Plan",
    "PolicyMonitor",
    "RoboChecker",
    "check_of",
    "compile",
    "slowed",
]
