"""Tasks and their assets: geometry, plans and success criteria. Knows no simulator.

`assets` has what stands on the table, `predicates` what the success of a task is made of.
"""

from rf_exp.tasks import assets, predicates
from rf_exp.tasks.account import Ledger
from rf_exp.tasks.configuration import (
    CONFIGURED,
    check_words,
    default_of,
    load_task,
    read_task,
    read_variation,
    stored_task,
)
from rf_exp.tasks.labels import labelled, labels
from rf_exp.tasks.specs import CameraSpec, ObjectSpec, Randomisation, RobotSpec
from rf_exp.tasks.start import Start
from rf_exp.tasks.success import SuccessEvaluator
from rf_exp.tasks.table import TABLE_CENTRE_M, TABLE_M
from rf_exp.tasks.task import Task
from rf_exp.tasks.variation import NONE, Variation, drawn_of, scene_certificate

__all__ = [
    "CONFIGURED",
    "NONE",
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
    "Variation",
    "assets",
    "check_words",
    "default_of",
    "drawn_of",
    "labelled",
    "labels",
    "load_task",
    "predicates",
    "read_task",
    "read_variation",
    "scene_certificate",
    "stored_task",
]
