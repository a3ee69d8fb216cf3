"""Contract between the suite and a policy of N arms: its observations and answers.

Agent k is row k - 1 of every array, in the order of the task's robots. Lengths are metres, angles radians,
poses (4, 4) matrices `a_from_b` or position and quaternion (w, x, y, z), frames as in the names.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

JOINTS, FINGERS = 7, 2
ACTION_SIZE = JOINTS + 1  # of an agent: joint targets in rad, and the gripper from -1 (closed) to 1 (open)
CONTROL_HZ = 20
STATES, CAMERAS = ("joints", "full", "none"), ("all", "local", "global")
# Robot and tasks of the suite, generated from its configuration: python -m tests.client.suite
SUITE: Mapping[str, Any] = json.loads(Path(__file__).with_name("suite.json").read_text("utf-8"))


class Entry(NamedTuple):
    """Shape, dtype and meaning of a key of an observation."""

    shape: tuple[int, ...]  # () for a text
    dtype: str  # of NumPy; `str` for a text
    meaning: str  # in words, with unit and frame


@dataclass(frozen=True)
class Contract:
    """Observations of a policy of some arms; the fields are those of the suite's `foreign.observations`.

    Raises ValueError for values that are not possible.
    """

    arms: int
    objects: tuple[str, ...] = ()  # whose true poses are observed with state `full`
    description: str = "Move the arms."  # the task in words
    state: str = "joints"  # joints | full | none
    pictures: bool = True
    depth: bool = False
    segmentation: bool = False
    calibration: bool = False
    language: bool = True
    cameras: str = "all"  # all | local (those of the agents) | global
    width: int = 320
    height: int = 240

    def __post_init__(self) -> None:
        for name, value, possible in (("state", self.state, STATES), ("cameras", self.cameras, CAMERAS)):
            if value not in possible:
                raise ValueError(f"unknown {name} {value!r}; available: {', '.join(possible)}")
        for name in ("arms", "width", "height"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")

    @classmethod
    def of_task(cls, task: str, **options: Any) -> "Contract":
        """The contract of a task of the suite, by its name. Raises ValueError for an unknown task."""
        if task not in SUITE["tasks"]:
            raise ValueError(f"unknown task {task!r}; available: {', '.join(SUITE['tasks'])}")
        task_facts = SUITE["tasks"][task]
        return cls(task_facts["arms"], tuple(task_facts["objects"]), task_facts["description"], **options)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """The selected ones of `global`, the shared camera, and `agent1` to `agentN`, one per agent."""
        local = tuple(f"agent{agent}" for agent in range(1, self.arms + 1))
        return {"all": ("global", *local), "local": local, "global": ("global",)}[self.cameras]

    @property
    def entries(self) -> dict[str, Entry]:
        """All keys of an observation but `reset`, the integer scene seed, only in an episode's first."""
        arms, size, single = self.arms, (self.height, self.width), [""]
        joints, cameras = (arms, JOINTS + FINGERS), [f"_{name}" for name in self.camera_names]
        objects = [f"_{name}" for name in self.objects]
        state, full, calibrated = self.state != "none", self.state == "full", self.calibration
        table = (  # (present, beginning of the keys, their endings, shape, kind of numbers, meaning)
            (state, "qpos", single, joints, "float32", "measured: seven joints in rad, two fingers in m"),
            (state, "qvel", single, joints, "float32", "their velocities: rad/s, m/s"),
            (full, "pose", objects, (7,), "float32", "world: position in m, quaternion w, x, y, z"),
            (self.pictures, "rgb", cameras, (*size, 3), "uint8", "RGB, rows from the top"),
            (self.depth, "depth", cameras, size, "float32", "m along the viewing direction; 0 is nothing"),
            (self.segmentation, "segmentation", cameras, size, "uint8", "which body; 0 is none"),
            (calibrated, "world_from_base", single, (arms, 4, 4), "float32", "where the arms stand, m"),
            (
                calibrated,
                "world_from_camera",
                cameras,
                (4, 4),
                "float32",
                "x right, y down, z forward (OpenCV), m",
            ),
            (calibrated, "intrinsics", cameras, (3, 3), "float32", "pixels from camera coordinates"),
            (self.language, "language", single, (), "str", "the task in words"),
        )
        return {
            key + ending: Entry(shape, dtype, meaning)
            for is_present, key, endings, shape, dtype, meaning in table
            if is_present
            for ending in endings
        }

    def synthetic_observation(self, seed: int = 0) -> dict[str, Any]:
        """A synthetic observation with valid keys, shapes and types: arms near rest, pictures of noise."""
        rng, rest = np.random.default_rng(seed), [*SUITE["rest_rad"], *[SUITE["open_m"]] * FINGERS]
        intrinsics = [[self.height, 0, self.width / 2], [0, self.height, self.height / 2], [0, 0, 1]]
        generators: dict[str, Callable[[tuple[int, ...]], ArrayLike]] = {  # beginning of a key -> its value
            "qpos": lambda _: rest + np.pad(rng.normal(0, 0.02, (self.arms, JOINTS)), ((0, 0), (0, FINGERS))),
            "qvel": np.zeros,
            "pose": lambda _: [*rng.uniform(-0.2, 0.2, 2), 0.05, 1, 0, 0, 0],
            "rgb": lambda shape: rng.integers(0, 256, shape),
            "depth": lambda shape: rng.uniform(0.5, 2.0, shape),
            "segmentation": lambda shape: rng.integers(0, 3, shape),
            "world": lambda shape: np.broadcast_to(np.eye(4), shape),
            "intrinsics": lambda _: intrinsics,
        }
        return {
            key: self.description if dtype == "str" else np.array(generators[key.split("_")[0]](shape), dtype)
            for key, (shape, dtype, _) in self.entries.items()
        }


def validate_chunk(answer: object, arms: int) -> NDArray[np.float64]:
    """The `actions` of a policy as a chunk (T, arms, 8). Raises ValueError for anything else."""
    contents = f"seven joint targets in rad and the gripper in [-1, 1] of {arms} agent{'s' * (arms > 1)}"
    size = ACTION_SIZE * arms
    expected = f"expected finite numbers (T, {arms}, {ACTION_SIZE}) or (T, {size}): {contents}"
    try:
        array = np.asarray(answer)
    except Exception as error:  # a tensor on a device, lists of different lengths
        raise ValueError(
            f"actions that are no array ({type(answer).__name__}: {error}); {expected}"
        ) from error
    if array.dtype.kind not in "iuf":
        raise ValueError(f"actions of type {array.dtype} ({type(answer).__name__}); {expected}")
    if not len(array.shape) or not len(array) or array.shape[1:] not in {(arms, ACTION_SIZE), (size,)}:
        raise ValueError(f"actions of shape {array.shape}; {expected}")
    chunk = array.reshape(-1, arms, ACTION_SIZE).astype(float)
    if not np.isfinite(chunk).all():
        step, row, joint = np.argwhere(~np.isfinite(chunk))[0].tolist()
        value_name = "gripper" if joint == JOINTS else f"joint {joint + 1}"
        raise ValueError(
            f"{value_name} of agent {row + 1} is {chunk[step, row, joint]} in step {step} of a chunk of "
            f"{len(chunk)}; {expected}"
        )
    return chunk
