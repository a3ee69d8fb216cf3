"""When who moves: the shortest schedule of agents on fixed paths, which keeps what is asked of it.

`Demands` are cells of coordination diagrams; `schedule` finds a proven shortest schedule, or says as a
violation why there is none; `sequential` lets agents take turns. `assign` says who does what, before there
are paths.
"""

from rf_exp.coordination.assignment import Assignment, assign
from rf_exp.coordination.scheduling import (
    Closing,
    Delays,
    Demands,
    Rule,
    actions,
    alike,
    intended,
    schedule,
    sequential,
)

__all__ = [
    "Assignment",
    "Closing",
    "Delays",
    "Demands",
    "Rule",
    "actions",
    "alike",
    "assign",
    "intended",
    "schedule",
    "sequential",
]
