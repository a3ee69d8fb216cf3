"""Compositional constraints: interfaces (logical, spatial, temporal) and RoboChecker.

Geometry and time only: no simulator, no learning. Start at `checker`. `stl` has the checks in signal temporal
logic.
"""

from rf_exp.constraints import stl
from rf_exp.constraints.checked import CheckedPlan
from rf_exp.constraints.checker import CheckCode, RoboChecker, compile
from rf_exp.constraints.checks.avoidance import AvoidAgents
from rf_exp.constraints.checks.touching import CONTACT_N, overlapping, pressing, touching
from rf_exp.constraints.compiler import check_of, compiled
from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.monitor import Monitor
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.policy_monitor import PolicyMonitor
from rf_exp.constraints.slowing import slowed

__all__ = [
    "CONTACT_N",
    "AvoidAgents",
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
    "compiled",
    "overlapping",
    "pressing",
    "slowed",
    "stl",
    "touching",
]
