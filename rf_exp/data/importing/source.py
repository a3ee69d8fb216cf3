"""Base of all importers: contents of a source, known before anything is copied, and checks of its rows.

Source files are not trusted: declared sizes are compared with the bytes present, numbers with their meaning,
and no reader is used that can run code (pickles).
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.data.release import COMMAND_SIZE, MAX_EXCESS_RAD, checked_task, within_limits
from rf_exp.errors import ArgumentError, StageError
from rf_exp.robots import DEFAULT
from rf_exp.store import Description, translate_decoder_errors
from rf_exp.types import FINGERS, Episode, camera_names

MOST_ROWS = 1_000_000  # of a source's array: 14 hours of motion
MOST_BYTES = 2**33  # of an array in one episode
MOST_CHUNK_BYTES = 2**30  # of a compressed chunk
MOST_AGENTS, LARGEST_PX = 99, 8192  # limits of a store
MOST_LISTED = 8  # names listed in a message

# what a source may lack -> the consequence
CONSEQUENCES = {
    "pictures": "policies that look cannot learn",
    "poses": "policies cannot be told where objects are (policy=state); episodes cannot be drawn again",
    "calibration": "where cameras and arms stand is not known, so keypoints cannot be learned (policy=fast "
    "and what builds on it); policy=paper does without",
    "measured joints": "qpos is what was commanded, fingers as far open as told; arms lag behind that",
    "velocities": "qvel is zero",
    "success": "whether an episode succeeds, and when, is not known; all of its rows were taken",
    "seeds": "episodes are numbered from 0 in place of the seeds of their scenes",
    "subgoals": "they are counted by the changes of each gripper; a policy that is told its own "
    "(arch=separate_coordinated) cannot act",
    "certificates": "no plan, check or verdict of RoboChecker is known",
}


@dataclass(frozen=True)
class Contents:
    """Contents of a source, as far as they are imported."""

    form: str  # format, in words
    task: str
    agents: int
    episodes: Sequence[str]  # their names in the source
    seeds: Sequence[int]
    steps: Sequence[int]  # imported steps of each episode
    cameras: Sequence[str] = ()
    size_px: tuple[int, int] = (0, 0)  # height and width of pictures
    objects: Sequence[str] = ()
    commands_digest: str = ""  # digest of all commands, to recognise the same source
    disturbed: bool = False  # whether executed commands differ from the intended ones
    scene: Mapping[str, Any] = field(default_factory=dict)  # poses of arms and cameras, as in an identity
    description: Description | None = None
    missing: Sequence[str] = ()  # keys of CONSEQUENCES
    notes: Sequence[str] = ()  # what was left out or changed

    @property
    def identity(self) -> dict[str, Any]:
        """Identity of the store that it is imported to."""
        imported = {
            "format": self.form,
            "episodes": len(self.seeds),
            "told": self.commands_digest,
            "missing": {what: CONSEQUENCES[what] for what in self.missing},
            "notes": list(self.notes),
        }
        identity = {"task": self.task, "imported": imported, "first_seed": min(self.seeds, default=0)}
        return identity | ({"scene": dict(self.scene)} if self.scene else {})


class Source(ABC):
    """Surveyed demonstrations of another data set, checked as far as possible without reading pictures."""

    contents: Contents

    @abstractmethod
    def episode(self, index: int) -> Episode:
        """Episode `index` of `contents`. Raises StageError where it cannot be read."""

    @abstractmethod
    def close(self) -> None:
        """Closes its files."""


def translating_errors(path: Path, what: str) -> AbstractContextManager[None]:
    """Turns errors of a decoder or of the system into a StageError."""
    return translate_decoder_errors(path, lambda why: import_error(path, f"{what} cannot be read {why}"))


def import_error(path: Path, what: str) -> StageError:
    """The error for a source that violates its format."""
    return StageError(f"{path} cannot be imported: {what}; restore it from a copy, or make it again")


def require(holds: bool, path: Path, what: str) -> None:
    """Raises StageError, saying `what` was found, unless a rule of the format holds."""
    if not holds:
        raise import_error(path, what)


def require_shape(path: Path, name: str, shape: Sequence[int], row: Sequence[int | None]) -> None:
    """Raises StageError unless an array has rows of that shape (None: any), at most `MOST_ROWS` of them."""
    fits = len(shape) == len(row) + 1 and all(
        wanted in (None, size) for size, wanted in zip(shape[1:], row, strict=True)
    )
    wanted = ", ".join("any" if size is None else str(size) for size in ("T", *row))
    require(fits, path, f"{name} has shape {tuple(shape)}; expected ({wanted})")
    require(shape[0] <= MOST_ROWS, path, f"{name} declares {shape[0]} rows; {MOST_ROWS} at most are read")


def finite_float32(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float32]:
    """The values as float32. Raises StageError for values that are not finite."""
    with np.errstate(over="ignore"):
        converted = values.astype(np.float32)
    require(bool(np.isfinite(converted).all()), path, f"{name} holds values that are not finite numbers")
    return converted


def checked_commands(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float32]:
    """Commands (T, N, 8) from (T, N * 8) or (T, N, 8). Raises StageError unless joint targets are in rad."""
    reshaped = finite_float32(path, name, values).reshape(
        len(values), prod(values.shape[1:]) // COMMAND_SIZE, COMMAND_SIZE
    )
    excess = within_limits(reshaped)[1]
    require(
        excess < MAX_EXCESS_RAD,
        path,
        f"{name} is up to {excess:.3g} beyond the limits of a {DEFAULT.title}; expected absolute joint "
        "targets in rad (control mode pd_joint_pos) and a gripper from -1 to 1",
    )
    return reshaped


def assumed_qpos(commands: NDArray[np.float32]) -> NDArray[np.float32]:
    """qpos (..., 9) of arms that follow their commands (..., 8) exactly, fingers included."""
    fingers = DEFAULT.hand.opening_m(commands[..., -1:]).astype(np.float32)
    return np.concatenate([commands[..., :-1], *[fingers] * FINGERS], axis=-1)


def counted_subgoals(commands: NDArray[np.float32]) -> tuple[NDArray[np.int16], list[list[str]]]:
    """(T, N) number of gripper changes so far in an episode (T, N, 8), and a text for each number.

    Grippers begin open. Keyframes are the same moments: those at which the own gripper changes.
    """
    gripper_changes = np.diff(commands[..., -1] > 0, axis=0, prepend=True)
    count = np.minimum(np.cumsum(gripper_changes, axis=0), np.iinfo(np.int16).max)
    texts = [[f"after {k} changes of the gripper" for k in range(total + 1)] for total in count.max(axis=0)]
    return count.astype(np.int16), texts


def action_and_executed(
    commands: NDArray[np.float32], executed: NDArray[np.float32] | None, disturbed: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """`action` of an episode, clipped to the limits, and `executed`, not clipped; None unless disturbed."""
    return within_limits(commands)[0], (commands if executed is None else executed) if disturbed else None


def sort_cameras(cameras: Iterable[str], agents: int) -> list[str]:
    """Cameras in the order of a store: global, those of the agents, others."""
    store_order = camera_names("all", agents)
    return sorted(
        cameras, key=lambda name: (store_order.index(name) if name in store_order else len(store_order), name)
    )


def checked_name(path: Path, task: str) -> str:
    """The task name of a source. Raises ArgumentError where it is empty or invalid."""
    if not task:
        raise ArgumentError(f"{path} does not say of which task it is; say so, as in --task lift_barrier")
    return checked_task(task)


def digest_commands(commands: Sequence[NDArray[np.float32]], seeds: Sequence[int]) -> str:
    """SHA-256 of the commands (T, N, 8) and seeds of episodes, shortened to 16 hexadecimal digits."""
    sha = hashlib.sha256()
    for seed, episode_commands in zip(seeds, commands, strict=True):
        sha.update(f"{seed} {episode_commands.shape}".encode())
        sha.update(episode_commands.tobytes())
    return sha.hexdigest()[:16]


def bounds_note(commands: Sequence[NDArray[np.float32]]) -> list[str]:
    """Note on commands beyond their limits; empty where there are none."""
    excess = [within_limits(episode_commands)[1] for episode_commands in commands]
    if not any(excess):
        return []
    return [
        f"commands of {np.count_nonzero(excess)} episodes are up to {max(excess):.3g} beyond the limits of "
        "joints (rad) and grippers: action holds them at the limit, executed as they were"
    ]


def scene_seeds(seeds: Sequence[int | None]) -> tuple[list[int], bool]:
    """Seeds of the episodes and True where all are known and differ; else numbers from 0 and False."""
    known = [seed for seed in seeds if seed is not None]
    if len(known) == len(seeds) and len({*known}) == len(known):
        return known, True
    return [*range(len(seeds))], False


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:MOST_LISTED]) + (
        f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    )
