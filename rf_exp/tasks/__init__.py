"""Tasks and their assets: geometry, plans and success criteria. Knows no simulator.

`assets` has what stands on the table, `predicates` what the success of a task is made of.
"""

from rf_exp.tasks import assets, predicates
from rf_exp.tasks.task import (
    CONFIGURED,
    TABLE_CENTRE_M,
    TABLE_M,
    CameraSpec,
    Ledger,
    ObjectSpec,
    Randomisation,
    RobotSpec,
    Start,
    SuccessEvaluator,
    Task,
    check_words,
    default_of,
    labelled,
    labels,
    load_task,
    read_task,
    stored_task,
)

__all__ = [
    "CONFIGURED",
    "TABLE_CENTRE_M",
    "TABLE_M",
    "CameraSpec",
    "Ledger",
    "ObjectSpec",
    "Randomisation",
    "RobotSpec",
    "Start",
    "SuccessEvaluator",
    "Task",
    "assets",
    "check_words",
    "default_of",
    "labelled",
    "labels",
    "load_task",
    "predicates",
    "read_task",
    "stored_task",
]
