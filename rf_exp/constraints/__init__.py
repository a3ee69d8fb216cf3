"""Compositional constraints: interfaces (logical, spatial, temporal) and RoboChecker.

Geometry and time only: no simulator, no learning. Start at `checker`. `stl` has the checks in signal temporal
logic.
"""

from rf_exp.constraints import stl
from rf_exp.constraints.bounded import BoundedCheck
from rf_exp.constraints.checker import CheckCode, CheckedPlan, RoboChecker, compile
from rf_exp.constraints.checks import AvoidAgentsCheck
from rf_exp.constraints.compiler import Plans, compiled
from rf_exp.constraints.evidence import Check, Evidence, OneAgentCheck, checked_kinds
from rf_exp.constraints.monitor import Monitor, PolicyMonitor
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.slowing import slowed
from rf_exp.constraints.touching import CONTACT_N, overlapping, pressing, touching

__all__ = [
    "CONTACT_N",
    "AvoidAgentsCheck",
    "BoundedCheck",
    "Check",
    "CheckCode",
    "CheckedPlan",
    "Evidence",
    "Monitor",
    "OneAgentCheck",
    "Paths",
    "Plan",
    "Plans",
    "PolicyMonitor",
    "RoboChecker",
    "checked_kinds",
    "compile",
    "compiled",
    "overlapping",
    "pressing",
    "slowed",
    "stl",
    "touching",
]
