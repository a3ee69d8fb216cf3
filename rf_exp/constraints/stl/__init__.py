"""Signal temporal logic: every check as formulas, and what rtamt says of an execution. Start at `form`."""

from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import (
    CLOCK_S,
    VOID,
    Comparison,
    Formula,
    Specification,
    always,
    bounded,
    condition,
    named,
    of_schedule,
)
from rf_exp.constraints.stl.robustness import Robust, evaluated, installed, judged, kept, signals

__all__ = [
    "CLOCK_S",
    "VOID",
    "Comparison",
    "Execution",
    "Formula",
    "Robust",
    "Signal",
    "Specification",
    "always",
    "bounded",
    "condition",
    "evaluated",
    "installed",
    "judged",
    "kept",
    "named",
    "of_schedule",
    "signals",
]
