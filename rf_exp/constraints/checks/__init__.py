"""The checks, a file for each kind under the name of its statement: compiled, planned, measured, in STL."""

from rf_exp.constraints.checks.avoidance import TRAILS_STEPS, AvoidAgentsCheck, AvoidObjectsCheck
from rf_exp.constraints.checks.before import BeforeCheck
from rf_exp.constraints.checks.deadline import DeadlineCheck
from rf_exp.constraints.checks.direction import DirectionCheck
from rf_exp.constraints.checks.interaction import ContactAtCheck, PlaceAtCheck
from rf_exp.constraints.checks.keep_apart import KeepApartCheck
from rf_exp.constraints.checks.keep_height import KeepHeightCheck
from rf_exp.constraints.checks.keep_level import KeepLevelCheck
from rf_exp.constraints.checks.keep_out import KeepOutCheck
from rf_exp.constraints.checks.same_height import SameHeightCheck
from rf_exp.constraints.checks.share_space import ShareSpaceCheck
from rf_exp.constraints.checks.speed_limit import SpeedLimitCheck
from rf_exp.constraints.checks.together import TogetherCheck

__all__ = [
    "TRAILS_STEPS",
    "AvoidAgentsCheck",
    "AvoidObjectsCheck",
    "BeforeCheck",
    "ContactAtCheck",
    "DeadlineCheck",
    "DirectionCheck",
    "KeepApartCheck",
    "KeepHeightCheck",
    "KeepLevelCheck",
    "KeepOutCheck",
    "PlaceAtCheck",
    "SameHeightCheck",
    "ShareSpaceCheck",
    "SpeedLimitCheck",
    "TogetherCheck",
]
