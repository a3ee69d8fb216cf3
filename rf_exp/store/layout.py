"""Layout of a store: its arrays, their chunks and files, and the attributes of arrays and store."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from rf_exp.artifacts import atomic_path, plain
from rf_exp.robots import DEFAULT, Robot
from rf_exp.types import FINGERS, UNITS, Episode, Judged

FORMAT = 3  # version of layout and attributes
MOST_JOINTS = 16  # of an arm with its gripper
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
JUDGED = ("value", "bound", "unit", "holds")  # the arrays of the conditions of success
ROW_DIMENSION = {"data": "step", "meta": "episode"}  # group -> name of the first dimension of its arrays
PICTURE_CHUNK, PICTURE_SHARD = 8, 256  # frames; a shard is one file
STATE_CHUNK, STATE_SHARD = 128, 1024  # rows; a damaged chunk loses only its own rows
CERTIFICATE_CHUNK, CERTIFICATE_SHARD = 1, 32  # episodes
META_CHUNK = 256  # episodes, a file each
ALWAYS_WRITE = {"write_empty_chunks": True}  # so that a missing file always means damage


@dataclass(frozen=True)
class Model:
    """Robot of an agent, as a store describes it."""

    title: str
    kind: str  # name in exported data sets
    joints: tuple[str, ...]  # names along its part of qpos and qvel: the arm, then the two fingers
    commands: tuple[str, ...]  # names along its part of action and executed

    @staticmethod
    def from_robot(robot: Robot) -> "Model":
        return Model(robot.title, robot.kind, robot.qpos_names, robot.command_names)


def robot_attributes(robots: Sequence[Robot]) -> dict[str, Any]:
    """The attribute that describes the agents' robots; absent where all are the default robot."""
    if all(robot == DEFAULT for robot in robots):
        return {}
    return {"robots": [asdict(Model.from_robot(robot)) for robot in robots]}


def models(attributes: Mapping[str, Any]) -> tuple[Model, ...]:
    """Robot of every agent. Raises ValueError for an invalid attribute."""
    agents = attributes["agents"]
    robots = attributes.get("robots", [asdict(Model.from_robot(DEFAULT))] * agents)
    names = [[tuple(map(str, robot[key])) for key in ("joints", "commands")] for robot in robots]
    parsed = tuple(
        Model(str(robot["title"]), str(robot["kind"]), *model_names)
        for robot, model_names in zip(robots, names, strict=True)
    )
    sizes = {len(model.joints) for model in parsed} | {len(model.commands) + 1 for model in parsed}
    if len(parsed) != agents or not all(FINGERS < size <= MOST_JOINTS for size in sizes):
        raise ValueError(f"{len(parsed)} robots with {sorted(sizes)} joints, of {agents} agents")
    return parsed


def joint_names(attributes: Mapping[str, Any], agent: int | None = None) -> tuple[str, ...]:
    """Names along qpos and qvel, of one agent or of all. See `rf_exp.types.joints_of` for the order."""
    return _padded_names([model.joints for model in models(attributes)], ("finger1", "finger2"), agent)


def command_names(attributes: Mapping[str, Any], agent: int | None = None) -> tuple[str, ...]:
    """Names along action and executed, of one agent or of all."""
    return _padded_names([model.commands for model in models(attributes)], ("gripper",), agent)


def _padded_names(
    names_by_agent: Sequence[tuple[str, ...]], gripper_names: Sequence[str], agent: int | None
) -> tuple[str, ...]:
    """Names padded to the longest, between arm and gripper; for agents that differ, numbered joints."""
    size, arm = max(map(len, names_by_agent)), -len(gripper_names)
    if agent is None and len(set(names_by_agent)) > 1:
        return (*(f"joint{k}" for k in range(1, size + arm + 1)), *gripper_names)
    names = names_by_agent[0 if agent is None else agent - 1]
    unused = (f"unused{k}" for k in range(len(names) + arm + 1, size + arm + 1))
    return (*names[:arm], *unused, *names[arm:])


@dataclass(frozen=True)
class Description:
    """Attributes of a store about the task, its conditions of success, arms and cameras."""

    language: Mapping[str, str]  # title, description, target_condition of the task
    conditions: Sequence[str]  # of success, in the order in which their values are stored
    world_from_base: Sequence[Any]  # (4, 4) of each arm
    # camera -> intrinsics (3, 3) px, and world_from_camera or hand_from_camera (4, 4), OpenCV axes
    camera_models: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    depth: bool = False  # whether depth is stored
    labels: Sequence[str] = ()  # meaning of the values of the segmentation; empty: none is stored

    def attributes(self) -> dict[str, Any]:
        return plain(asdict(self))

    @classmethod
    def of(cls, attributes: Mapping[str, Any]) -> Self | None:
        """The description in the attributes of a store; None for a store without one."""
        if "conditions" not in attributes:
            return None
        return cls(**{attribute.name: attributes[attribute.name] for attribute in fields(cls)})


class Kind(NamedTuple):
    """Contents of one kind of array."""

    dtype: Any
    dimensions: tuple[str, ...]  # of a row
    about: str
    units: Any = None  # along the last dimension; the first one is repeated for all joints of the arm
    frame: str | None = None


JOINTS, COMMANDS = ("agent", "joint"), ("agent", "command")
# Keys: the part of an array's name before its first `_`, or all of `condition_...`.
KINDS: Mapping[str, Kind] = {
    "qpos": Kind("float32", JOINTS, "measured joints before the action", ("rad", "m", "m")),
    "qvel": Kind("float32", JOINTS, "measured joint velocities before the action", ("rad/s", "m/s", "m/s")),
    "action": Kind(
        "float32",
        COMMANDS,
        "joint targets of the next control step; gripper from -1 closed to 1 open",
        ("rad", "1"),
    ),
    "executed": Kind(
        "float32", COMMANDS, "what the arms were told; `action` is what was meant", ("rad", "1")
    ),
    "subgoal": Kind(
        "int16",
        ("agent",),
        "each agent's, an index of its texts in the certificate's `subgoals`; -1: not known",
    ),
    "pose": Kind(
        "float32",
        ("pose",),
        "position and unit quaternion w, x, y, z of the object's frame",
        ("m", "m", "m", "1", "1", "1", "1"),
        "world: z up, table top at z = 0",
    ),
    "time": Kind("float64", (), "since the start of the episode", "s"),
    "condition_value": Kind("float32", ("condition",), "measured after the action; 1 or 0 of yes or no"),
    "condition_bound": Kind("float32", ("condition",), "what the value is held against, in its unit"),
    "condition_unit": Kind("uint8", ("condition",), "of value and bound: index of units", UNITS),
    "condition_holds": Kind("bool", ("condition",), "whether it holds after the action"),
    "depth": Kind("uint16", ("height", "width"), "along the viewing direction; 0 is nothing", "mm"),
    "segmentation": Kind("uint8", ("height", "width"), "index of the store's `labels`"),
    "rgb": Kind("uint8", ("height", "width", "channel"), "sRGB, seen before the action"),
    "seed": Kind("int64", (), "of the scene"),
    "certificate": Kind(
        np.dtypes.StringDType(), (), "JSON: proposals, check code, verdicts, subgoals, the row of the attempt"
    ),
    "episode": Kind("int64", (), "row of `data` after the last of each episode"),
}


def kind_of(name: str) -> Kind:
    what = name.partition("/")[2]
    return KINDS[what if what.startswith("condition_") else what.partition("_")[0]]


def layout(attributes: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Array name -> (shape of one row, dtype), the whole layout of a store."""
    names, cameras = ["qpos", "qvel", "action"], attributes["cameras"]
    names += ["executed"] if attributes.get("disturbed") else []
    names += ["subgoal", *(f"pose_{object_name}" for object_name in attributes["objects"])]
    if "conditions" in attributes:
        names += ["time_s", *(f"condition_{quantity}" for quantity in JUDGED)]
        names += [f"depth_{camera}" for camera in cameras if attributes["depth"]]
        names += [f"segmentation_{camera}" for camera in cameras if attributes["labels"]]
    names += [f"rgb_{camera}" for camera in cameras]
    sizes = {
        "agent": attributes["agents"],
        "joint": len(joint_names(attributes)),
        "command": len(command_names(attributes)),
        "pose": len(POSE),
        "condition": len(attributes.get("conditions", ())),
        "height": attributes["height"],
        "width": attributes["width"],
        "channel": 3,
    }
    arrays = [f"data/{name}" for name in names] + ["meta/seed", "meta/certificate", "meta/episode_ends"]
    return {
        name: (tuple(sizes[dimension] for dimension in kind.dimensions), kind.dtype)
        for name, kind in zip(arrays, map(kind_of, arrays), strict=True)
    }


def array_attributes(name: str, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of an array: what it holds, the names along its last dimension, units, frame."""
    dimension_names: dict[str, Any] = {
        "joint": joint_names(attributes),
        "command": command_names(attributes),
        "pose": POSE,
        "condition": attributes.get("conditions"),
        "channel": ("red", "green", "blue"),
    }
    kind = kind_of(name)
    names: Any = dimension_names.get(kind.dimensions[-1]) if kind.dimensions else None
    units = kind.units
    if units is not None and kind.dimensions[:1] == ("agent",):
        units = (*units[:1] * (len(names) - len(units)), *units)
    description = {"names": names, "units": units, "frame": kind.frame, "about": kind.about}
    return plain({key: value for key, value in description.items() if value is not None})


def extra_names(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the stored arrays `depth_<camera>` and `segmentation_<camera>`."""
    names = (name.removeprefix("data/") for name in layout(attributes))
    return tuple(name for name in names if name.startswith(("depth_", "segmentation_")))


def build_episode(
    attributes: Mapping[str, Any],
    seed: int,
    certificate: Callable[[], Any],
    rows: Callable[[str], NDArray[Any]],
) -> Episode:
    """An episode; `rows` returns its rows of an array, by the name of the array below `data`."""
    judged = attributes.get("conditions")
    return Episode(
        task=str(attributes["task"]),
        seed=seed,
        qpos=rows("qpos"),
        qvel=rows("qvel"),
        action=rows("action"),
        images={camera: rows(f"rgb_{camera}") for camera in attributes["cameras"]},
        certificate=certificate(),
        poses={name: rows(f"pose_{name}") for name in attributes["objects"]},
        executed=rows("executed") if attributes.get("disturbed") else None,
        subgoal=rows("subgoal"),
        judged=None if judged is None else read_judged(judged, rows),
        extras={name: rows(name) for name in extra_names(attributes)},
    )


def read_judged(conditions: Sequence[str], rows: Callable[[str], NDArray[Any]]) -> Judged:
    return Judged(tuple(conditions), **{name: rows(f"condition_{name}") for name in JUDGED})


def is_picture(name: str) -> bool:
    return "height" in kind_of(name).dimensions


def chunking(name: str) -> tuple[int, int | None]:
    """(rows of a chunk, compressed with one checksum; rows of a file of such chunks, None: the same)."""
    if is_picture(name):
        return PICTURE_CHUNK, PICTURE_SHARD
    if name == "meta/certificate":
        return CERTIFICATE_CHUNK, CERTIFICATE_SHARD
    return (META_CHUNK, None) if name.startswith("meta/") else (STATE_CHUNK, STATE_SHARD)


def empty_like(path: Path, attributes: Mapping[str, Any]) -> None:
    """Creates a store without episodes, with these attributes. Raises OSError where that is not possible."""
    with atomic_path(path) as draft:
        group = zarr.create_group(draft, attributes=dict(attributes))
        for name, (shape, dtype) in layout(attributes).items():
            chunk, shard = chunking(name)
            group.create_array(
                name,
                shape=(0, *shape),
                dtype=dtype,
                chunks=(chunk, *shape),
                shards=(shard, *shape) if shard else None,
                filters=None,
                compressors=ZstdCodec(level=3, checksum=True),
                dimension_names=(ROW_DIMENSION[name.partition("/")[0]], *kind_of(name).dimensions),
                attributes=array_attributes(name, attributes),
            )


def get_array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    array = group[name]
    assert isinstance(array, zarr.Array)
    return array


def rows_per_file(array: zarr.Array[Any]) -> int:
    return (array.shards or array.chunks)[0]


def file_of_row(array: zarr.Array[Any], row: int) -> str:
    """Path of the file that holds a row, relative to the folder of the array."""
    return array.metadata.encode_chunk_key((row // rows_per_file(array), *[0] * (array.ndim - 1)))


def view(array: zarr.Array[Any], rows: int) -> zarr.Array[Any]:
    """The array as if it had that many rows; the stored shape stays."""
    metadata = array.metadata.update_shape((rows, *array.shape[1:]))
    return zarr.Array(zarr.AsyncArray(metadata, array.store_path, ALWAYS_WRITE))  # pyright: ignore


def write(array: zarr.Array[Any], start: int, values: NDArray[Any]) -> None:
    """Writes rows from `start` on, and only then extends the stored shape."""
    end = start + len(values)
    view(array, end)[start:end] = values
    array.resize((end, *array.shape[1:]))
