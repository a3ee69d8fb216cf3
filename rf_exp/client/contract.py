"""Contract between the suite and a policy of N arms: what it observes, and what it answers.

Agent k is row k - 1 of every array, in the order of the task's robots. Lengths are metres, angles radians,
poses (4, 4) matrices `a_from_b` or position and quaternion (w, x, y, z), frames those that the names say.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

JOINTS, FINGERS = 7, 2
ACTION_SIZE = JOINTS + 1  # of an agent: joint targets in rad, and the gripper from -1 (closed) to 1 (open)
CONTROL_HZ = 20
STATES, CAMERAS = ("joints", "full", "none"), ("all", "local", "global")
# Robot and tasks of the suite, written from its configuration: python -m tests.client.suite
SUITE: Mapping[str, Any] = json.loads(Path(__file__).with_name("suite.json").read_text("utf-8"))


class Entry(NamedTuple):
    """What a key of an observation holds."""

    shape: tuple[int, ...]  # () of a text
    dtype: str  # of NumPy; `str` of a text
    holds: str  # in words, with unit and frame


@dataclass(frozen=True)
class Contract:
    """What a policy of some arms observes; the fields are those of `foreign.observations` of the suite.

    Raises ValueError for values that are not possible.
    """

    arms: int
    objects: tuple[str, ...] = ()  # whose true poses are told with state `full`
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
        for name, value, possible in (
            ("state", self.state, STATES),
            ("cameras", self.cameras, CAMERAS),
        ):
            if value not in possible:
                raise ValueError(f"unknown {name} {value!r}; available: {', '.join(possible)}")
        for name in ("arms", "width", "height"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")

    @classmethod
    def of_task(cls, task: str, **options: Any) -> "Contract":
        """That of a task of the suite, by its name. Raises ValueError for one that it does not have."""
        if task not in SUITE["tasks"]:
            raise ValueError(f"unknown task {task!r}; available: {', '.join(SUITE['tasks'])}")
        found = SUITE["tasks"][task]
        return cls(found["arms"], tuple(found["objects"]), found["description"], **options)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """`global`, that of nobody, and `agent1` to `agentN`, whose pictures are those of one agent."""
        local = tuple(f"agent{agent}" for agent in range(1, self.arms + 1))
        return {"all": ("global", *local), "local": local, "global": ("global",)}[self.cameras]

    @property
    def entries(self) -> dict[str, Entry]:
        """All keys of an observation but `reset`, the seed of the scene, an integer in the first alone."""
        found: dict[str, Entry] = {}
        arms, size = self.arms, (self.height, self.width)
        if self.state != "none":
            joints = (arms, JOINTS + FINGERS)
            found["qpos"] = Entry(joints, "float32", "measured: seven joints in rad, two fingers in m")
            found["qvel"] = Entry(joints, "float32", "their velocities: rad/s, m/s")
        if self.state == "full":
            pose = Entry((7,), "float32", "world: position in m, quaternion w, x, y, z")
            found |= {f"pose_{name}": pose for name in self.objects}
        if self.pictures:
            picture = Entry((*size, 3), "uint8", "RGB, rows from the top")
            found |= {f"rgb_{name}": picture for name in self.camera_names}
        if self.depth:
            depth = Entry(size, "float32", "m along the viewing direction; 0 is nothing")
            found |= {f"depth_{name}": depth for name in self.camera_names}
        if self.segmentation:
            bodies = Entry(size, "uint8", "which body; 0 is none")
            found |= {f"segmentation_{name}": bodies for name in self.camera_names}
        if self.calibration:
            found["world_from_base"] = Entry((arms, 4, 4), "float32", "where the arms stand, m")
            eye = Entry((4, 4), "float32", "x right, y down, z forward (OpenCV), m")
            found |= {f"world_from_camera_{name}": eye for name in self.camera_names}
            lens = Entry((3, 3), "float32", "pixels from camera coordinates")
            found |= {f"intrinsics_{name}": lens for name in self.camera_names}
        if self.language:
            found["language"] = Entry((), "str", "the task in words")
        return found

    def made_up(self, seed: int = 0) -> dict[str, Any]:
        """An observation of the right keys, shapes and types: arms near their rest, pictures of noise."""
        rng = np.random.default_rng(seed)
        made: dict[str, Any] = {}
        for key, (shape, dtype, _) in self.entries.items():
            kind = key.split("_")[0]
            if kind == "qpos":
                values = np.tile([*SUITE["rest_rad"], *[SUITE["open_m"]] * FINGERS], (self.arms, 1))
                values[:, :JOINTS] += rng.normal(0, 0.02, (self.arms, JOINTS))
            elif kind == "qvel":
                values = np.zeros(shape)
            elif kind == "pose":
                values = np.array([*rng.uniform(-0.2, 0.2, 2), 0.05, 1, 0, 0, 0])
            elif kind in ("rgb", "segmentation"):
                values = rng.integers(0, 256 if kind == "rgb" else 3, shape)
            elif kind == "depth":
                values = rng.uniform(0.5, 2.0, shape)
            elif kind == "world":
                values = np.tile(np.eye(4), (*shape[:-2], 1, 1))
            elif kind == "intrinsics":
                values = np.array(
                    [[self.height, 0, self.width / 2], [0, self.height, self.height / 2], [0, 0, 1]]
                )
            else:
                made[key] = self.description
                continue
            made[key] = values.astype(dtype)
        return made


def checked(answer: object, arms: int) -> NDArray[np.float64]:
    """The `actions` that a policy gave, as a chunk (T, arms, 8). Raises ValueError for anything else."""
    each = f"seven joint targets in rad and the gripper in [-1, 1] of {arms} agent{'s' * (arms > 1)}"
    size = ACTION_SIZE * arms
    expected = f"expected finite numbers (T, {arms}, {ACTION_SIZE}) or (T, {size}): {each}"
    try:
        array = np.asarray(answer)
    except Exception as error:  # a tensor elsewhere, lists of different lengths
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
        which = "gripper" if joint == JOINTS else f"joint {joint + 1}"
        raise ValueError(
            f"{which} of agent {row + 1} is {chunk[step, row, joint]} in step {step} of a chunk of "
            f"{len(chunk)}; {expected}"
        )
    return chunk
