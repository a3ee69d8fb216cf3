"""What a store says of its contents, so that nobody has to look into the code that made it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

from rf_exp.artifacts import plain
from rf_exp.robots import DEFAULT, Robot
from rf_exp.types import FINGERS, UNITS

MOST_JOINTS = 16  # of an arm with its hand
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class Model:
    """What a store says of the robot of an agent."""

    title: str
    kind: str  # as others call it
    joints: tuple[str, ...]  # along its part of qpos and qvel: of the arm, then of the two fingers
    commands: tuple[str, ...]  # along its part of action and executed

    @staticmethod
    def of(robot: Robot) -> "Model":
        return Model(robot.title, robot.kind, robot.measured, robot.told)


def stated(robots: Sequence[Robot]) -> dict[str, Any]:
    """The attribute that tells of the robots of the agents; without it all are the usual one."""
    if all(robot == DEFAULT for robot in robots):
        return {}
    return {"robots": [asdict(Model.of(robot)) for robot in robots]}


def models(attributes: Mapping[str, Any]) -> tuple[Model, ...]:
    """Of every agent. Raises ValueError for an attribute that cannot be."""
    agents = attributes["agents"]
    said = attributes.get("robots", [asdict(Model.of(DEFAULT))] * agents)
    found = tuple(
        Model(
            str(each["title"]),
            str(each["kind"]),
            *(tuple(map(str, each[key])) for key in ("joints", "commands")),
        )
        for each in said
    )
    sizes = {len(each.joints) for each in found} | {len(each.commands) + 1 for each in found}
    if len(found) != agents or not all(FINGERS < size <= MOST_JOINTS for size in sizes):
        raise ValueError(f"{len(found)} robots with {sorted(sizes)} joints, of {agents} agents")
    return found


def joint_names(attributes: Mapping[str, Any], agent: int | None = None) -> tuple[str, ...]:
    """Names along qpos and qvel, of one agent or of all. See `rf_exp.types.joints_of` for what lies where."""
    return _names([model.joints for model in models(attributes)], FINGERS, "finger", agent)


def command_names(attributes: Mapping[str, Any], agent: int | None = None) -> tuple[str, ...]:
    """Names along action and executed, of one agent or of all."""
    return _names([model.commands for model in models(attributes)], 1, "gripper", agent)


def _names(each: Sequence[tuple[str, ...]], hand: int, last: str, agent: int | None) -> tuple[str, ...]:
    """Padded to the longest: between arm and hand. Of several that differ, the numbers of the joints."""
    size = max(map(len, each))
    if agent is None and len(set(each)) > 1:
        fingers = [last] if hand == 1 else [f"{last}{k}" for k in range(1, hand + 1)]
        return (*(f"joint{k}" for k in range(1, size - hand + 1)), *fingers)
    names = each[0 if agent is None else agent - 1]
    unused = (f"unused{k}" for k in range(len(names) - hand + 1, size - hand + 1))
    return (*names[:-hand], *unused, *names[-hand:])


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
    joints, commands = joint_names(attributes), command_names(attributes)
    rad = ["rad"] * (len(commands) - 1)
    conditions = list(attributes.get("conditions", ()))
    found: dict[str, dict[str, Any]] = {
        "qpos": {"names": joints, "units": [*rad, "m", "m"], "about": "measured joints before the action"},
        "qvel": {
            "names": joints,
            "units": [*["rad/s"] * len(rad), "m/s", "m/s"],
            "about": "measured joint velocities before the action",
        },
        "action": {
            "names": commands,
            "units": [*rad, "1"],
            "about": "joint targets of the next control step; gripper from -1 closed to 1 open",
        },
        "executed": {
            "names": commands,
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
