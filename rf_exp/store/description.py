"""What a store says of its contents, so that nobody has to look into the code that made it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

from rf_exp.artifacts import plain
from rf_exp.types import UNITS

ARM = tuple(f"panda_joint{k}" for k in range(1, 8))
JOINTS = (*ARM, "panda_finger_joint1", "panda_finger_joint2")  # of qpos and qvel
COMMANDS = (*ARM, "gripper")  # of action and executed
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class Description:
    """What the demonstrations are about and how they were seen; attributes of a store."""

    language: Mapping[str, str]  # title, description, target_condition of the task
    conditions: Sequence[str]  # of success, in the order in which their values are stored
    world_from_base: Sequence[Any]  # (4, 4) of each arm
    # camera -> intrinsics (3, 3) px, and world_from_camera or hand_from_camera (4, 4), OpenCV axes
    camera_models: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    depth: bool = False  # whether the pictures' depth is kept
    labels: Sequence[str] = ()  # what the numbers of the segmentation mean; none is kept without

    def attributes(self) -> dict[str, Any]:
        return plain(asdict(self))

    @classmethod
    def of(cls, attributes: Mapping[str, Any]) -> Self | None:
        """That of a store; None for one that was made without it."""
        if "conditions" not in attributes:
            return None
        return cls(**{each.name: attributes[each.name] for each in fields(cls)})


def dimensions(name: str) -> tuple[str, ...]:
    """The names of the dimensions of an array."""
    group, _, what = name.partition("/")
    if group == "meta":
        return ("episode",)
    kind = what.partition("_")[0]
    inner = {
        "qpos": ("agent", "joint"),
        "qvel": ("agent", "joint"),
        "action": ("agent", "command"),
        "executed": ("agent", "command"),
        "subgoal": ("agent",),
        "pose": ("pose",),
        "condition": ("condition",),
        "rgb": ("height", "width", "channel"),
        "depth": ("height", "width"),
        "segmentation": ("height", "width"),
    }
    return ("step", *inner.get(kind, ()))


def explained(name: str, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of an array: what it holds, the names along its last dimension, units, frame."""
    what = name.partition("/")[2]
    kind = what if what.startswith("condition_") else what.partition("_")[0]
    rad = ["rad"] * len(ARM)
    conditions = list(attributes.get("conditions", ()))
    found: dict[str, dict[str, Any]] = {
        "qpos": {"names": JOINTS, "units": [*rad, "m", "m"], "about": "measured joints before the action"},
        "qvel": {
            "names": JOINTS,
            "units": [*["rad/s"] * len(ARM), "m/s", "m/s"],
            "about": "measured joint velocities before the action",
        },
        "action": {
            "names": COMMANDS,
            "units": [*rad, "1"],
            "about": "joint targets of the next control step; gripper from -1 closed to 1 open",
        },
        "executed": {
            "names": COMMANDS,
            "units": [*rad, "1"],
            "about": "what the arms were told; `action` is what was meant",
        },
        "subgoal": {
            "about": "each agent's, an index of its texts in the certificate's `subgoals`; -1: not known"
        },
        "pose": {
            "names": POSE,
            "units": ["m", "m", "m", "1", "1", "1", "1"],
            "frame": "world: z up, table top at z = 0",
            "about": "position and unit quaternion w, x, y, z of the object's frame",
        },
        "time": {"units": "s", "about": "since the start of the episode"},
        "condition_value": {"names": conditions, "about": "measured after the action; 1 or 0 of yes or no"},
        "condition_bound": {"names": conditions, "about": "what the value is held against, in its unit"},
        "condition_unit": {
            "names": conditions,
            "units": UNITS,
            "about": "of value and bound: index of units",
        },
        "condition_holds": {"names": conditions, "about": "whether it holds after the action"},
        "rgb": {"names": ["red", "green", "blue"], "about": "sRGB, seen before the action"},
        "depth": {"units": "mm", "about": "along the viewing direction; 0 is nothing"},
        "segmentation": {"about": "index of the store's `labels`"},
        "seed": {"about": "of the scene"},
        "certificate": {"about": "JSON: proposals, check code, verdicts, subgoals, the row of the attempt"},
        "episode": {"about": "row of `data` after the last of each episode"},
    }
    return plain(found[kind])
