"""Mistakes that a proposal can hold, by name. Each takes a sound proposal and puts one mistake in."""

from rf_exp.datagen.brain.faults.assignment import ASSIGNMENT
from rf_exp.datagen.brain.faults.fault import Fault
from rf_exp.datagen.brain.faults.limits import LIMITS
from rf_exp.datagen.brain.faults.logical import LOGICAL
from rf_exp.datagen.brain.faults.spatial import SPATIAL
from rf_exp.datagen.brain.faults.temporal import TEMPORAL
from rf_exp.errors import choices

__all__ = ["FAULTS", "Fault", "fault_named"]

FAULTS: dict[str, Fault] = {
    fault.name: fault for fault in (*LOGICAL, *ASSIGNMENT, *TEMPORAL, *SPATIAL, *LIMITS)
}


def fault_named(fault: str) -> Fault:
    """The fault of that name. Raises ArgumentError that lists them."""
    if fault not in FAULTS:
        raise choices("fault", fault, FAULTS)
    return FAULTS[fault]
