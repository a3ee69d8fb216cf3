"""What every task has: its configuration, the starts of its episodes, and who judges them."""

from rf_exp.tasks.task.account import Ledger
from rf_exp.tasks.task.configuration import (
    CONFIGURED,
    check_words,
    default_of,
    load_task,
    read_task,
    read_variation,
    stored_task,
)
from rf_exp.tasks.task.labels import labelled, labels
from rf_exp.tasks.task.specs import CameraSpec, ObjectSpec, Randomisation, RobotSpec
from rf_exp.tasks.task.start import Start
from rf_exp.tasks.task.success import SuccessEvaluator
from rf_exp.tasks.task.table import TABLE_CENTRE_M, TABLE_M
from rf_exp.tasks.task.task import Task
from rf_exp.tasks.task.variation import FACTORS, NONE, PHYSICAL, Variation, drawn_of, scene_certificate

__all__ = [
    "CONFIGURED",
    "FACTORS",
    "NONE",
    "PHYSICAL",
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
    "check_words",
    "default_of",
    "drawn_of",
    "labelled",
    "labels",
    "load_task",
    "read_task",
    "read_variation",
    "scene_certificate",
    "stored_task",
]
