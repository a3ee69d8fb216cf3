"""Signal temporal logic: every check as formulas, and what rtamt says of an execution. Start at `form`."""

from rf_exp.constraints.stl import limits, logical, spatial, temporal  # noqa: F401 - their forms
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import (
    VOID,
    Formula,
    Specification,
    always,
    bounded,
    condition,
    named,
    stl_of,
)
from rf_exp.constraints.stl.robustness import Robust, evaluated, installed, judged, kept, signals

__all__ = [
    "VOID",
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
    "signals",
    "stl_of",
]
