"""The values that flow between the stages. Frozen, without behaviour beyond derived numbers.

Agents are numbered from 1 as in the paper (Agent_1); arrays over agents have agent k at index
k - 1. World frame: table top at z = 0. Units: metres, radians, seconds; control steps at 20 Hz.
"""

from rf_exp.types.choices import (
    FOREIGN,
    LARGEST_PX,
    NO_EXTRAS,
    NO_PICTURES,
    SMALLEST_PX,
    Arch,
    CameraChoice,
    ConstraintSet,
    Extras,
    JointLimits,
    Kind,
    Occupancy,
    Pictures,
    camera_names,
)
from rf_exp.types.episode import Episode, KeypointDetection, Rollout, RolloutStep
from rf_exp.types.motion import Schedule, Segment, Subgoal, Trajectory, what_of
from rf_exp.types.rows import FINGERS, arm_of, fingers_of, gripper_of, joints_of
from rf_exp.types.scene import (
    ARM_JOINTS,
    CONTROL_DT_S,
    CONTROL_HZ,
    GRIPPER_CLOSED,
    GRIPPER_OPEN,
    CameraModel,
    Scene,
    SeeingWorld,
    World,
)
from rf_exp.types.success import UNITS, Condition, Judged, Measured, Verdict
from rf_exp.types.timeline import activity, doing, spans

__all__ = [
    "ARM_JOINTS",
    "CONTROL_DT_S",
    "CONTROL_HZ",
    "FINGERS",
    "FOREIGN",
    "GRIPPER_CLOSED",
    "GRIPPER_OPEN",
    "LARGEST_PX",
    "NO_EXTRAS",
    "NO_PICTURES",
    "SMALLEST_PX",
    "UNITS",
    "Arch",
    "CameraChoice",
    "CameraModel",
    "Condition",
    "ConstraintSet",
    "Episode",
    "Extras",
    "JointLimits",
    "Judged",
    "KeypointDetection",
    "Kind",
    "Measured",
    "Occupancy",
    "Pictures",
    "Rollout",
    "RolloutStep",
    "Scene",
    "Schedule",
    "SeeingWorld",
    "Segment",
    "Subgoal",
    "Trajectory",
    "Verdict",
    "World",
    "activity",
    "arm_of",
    "camera_names",
    "doing",
    "fingers_of",
    "gripper_of",
    "joints_of",
    "spans",
    "what_of",
]
