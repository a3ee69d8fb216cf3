"""Planner and checker for third-party ManiSkill scenes: read, plan, check, schedule, execute.

Start with `Workcell`. See docs/library.md.
"""

from rf_exp.datagen import Planned
from rf_exp.errors import ArgumentError, RfError
from rf_exp.findings import Violation
from rf_exp.library.workcell import Execution, NoPlan, Workcell
from rf_exp.statements import (
    AvoidAgents,
    AvoidObjects,
    Before,
    ContactAt,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    LiesOn,
    PlaceAt,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
)
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import from_axes, transform
from rf_exp.types import ConstraintSet, JointLimits, Scene, Subgoal

__all__ = [
    "ArgumentError",
    "AvoidAgents",
    "AvoidObjects",
    "Before",
    "ConstraintSet",
    "ContactAt",
    "Deadline",
    "Direction",
    "Execution",
    "InteractionPoint",
    "JointLimits",
    "KeepApart",
    "KeepHeight",
    "KeepLevel",
    "KeepOut",
    "LiesOn",
    "NoPlan",
    "PlaceAt",
    "Planned",
    "RfError",
    "SameHeight",
    "Scene",
    "ShareSpace",
    "SpeedLimit",
    "Statement",
    "Step",
    "Subgoal",
    "Together",
    "Violation",
    "Workcell",
    "from_axes",
    "transform",
]
