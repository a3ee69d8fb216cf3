"""Compositional constraints: interfaces (logical, spatial, temporal) and RoboChecker.

Geometry and time only: no simulator, no learning. Start at `checker`. `stl` has the checks in signal temporal
logic.
"""

from rf_exp.constraints import stl
from rf_exp.constraints.check import (
    BoundedCheck,
    Check,
    Evidence,
    OneAgentCheck,
    Plans,
    checked_kinds,
    compiled,
)
from rf_exp.constraints.checker import CheckCode, CheckedPlan, Monitor, PolicyMonitor, RoboChecker, compile
from rf_exp.constraints.checks.avoidance import (
    CONTACT_N,
    AvoidAgentsCheck,
    overlapping,
    pressing,
    protective_stop,
    touching,
)
from rf_exp.constraints.checks.speed_limit import slowed
from rf_exp.constraints.plan import Paths, Plan

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
    "protective_stop",
    "slowed",
    "stl",
    "touching",
]
