"""What all importers share: what a source holds, known before anything is copied, and how rows are checked.

A source is somebody else's file, of which nothing is believed: sizes are held against the bytes that are
there, numbers against what they are to mean, and no reader is used that runs code (pickles).
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

from rf_exp.data.release import COMMAND, FARTHEST, checked_task, within_limits
from rf_exp.errors import ArgumentError, StageError
from rf_exp.robots import DEFAULT
from rf_exp.store import Description, decoding
from rf_exp.types import FINGERS, Episode, camera_names

MOST_ROWS = 1_000_000  # of a source's array: 14 hours of motion
MOST_BYTES = 2**33  # of an array of one episode, and
MOST_CHUNK_BYTES = 2**30  # of what is compressed together
MOST_AGENTS, LARGEST_PX = 99, 8192  # as a store may have
SHOWN = 8  # things that are named

# What a source may lack, and what therefore cannot be done.
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
    """What a source holds, as far as it will be taken."""

    form: str  # of what kind it is, in words
    task: str
    agents: int
    episodes: Sequence[str]  # what the source calls them
    seeds: Sequence[int]
    steps: Sequence[int]  # that are taken of each
    cameras: Sequence[str] = ()
    size_px: tuple[int, int] = (0, 0)  # height and width of pictures
    objects: Sequence[str] = ()
    told: str = ""  # digest of all commands: whether another source is the same one
    disturbed: bool = False  # whether commands that are executed differ from those that are kept as meant
    scene: Mapping[str, Any] = field(default_factory=dict)  # where arms and cameras stand, as in an identity
    description: Description | None = None
    missing: Sequence[str] = ()  # keys of CONSEQUENCES
    notes: Sequence[str] = ()  # what was left out or changed

    @property
    def identity(self) -> dict[str, Any]:
        """What the store of it is made of."""
        imported = {
            "format": self.form,
            "episodes": len(self.seeds),
            "told": self.told,
            "missing": {what: CONSEQUENCES[what] for what in self.missing},
            "notes": list(self.notes),
        }
        said = {"task": self.task, "imported": imported, "first_seed": min(self.seeds, default=0)}
        return said | ({"scene": dict(self.scene)} if self.scene else {})


class Source(ABC):
    """Demonstrations of somebody else, surveyed: what can be wrong without reading pictures is known."""

    contents: Contents

    @abstractmethod
    def episode(self, index: int) -> Episode:
        """One of those of `contents`. Raises StageError where it cannot be read."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of its files."""


def reads(path: Path, what: str) -> AbstractContextManager[None]:
    """Turns what a decoder raises on bytes that it does not understand, or the system, into a StageError."""
    return decoding(path, lambda why: refused(path, f"{what} cannot be read {why}"))


def refused(path: Path, what: str) -> StageError:
    """The error for a source that is not as its format says."""
    return StageError(f"{path} cannot be imported: {what}; restore it from a copy, or make it again")


def expect(holds: bool, path: Path, what: str) -> None:
    """Raises StageError unless something is as the format says; `what` is."""
    if not holds:
        raise refused(path, what)


def checked_shape(path: Path, name: str, shape: Sequence[int], row: Sequence[int | None]) -> None:
    """Raises StageError unless an array has rows of that shape (None: any), as many as can be."""
    fits = len(shape) == len(row) + 1 and all(
        wanted in (None, size) for size, wanted in zip(shape[1:], row, strict=True)
    )
    wanted = ", ".join("any" if size is None else str(size) for size in ("T", *row))
    expect(fits, path, f"{name} has shape {tuple(shape)}; expected ({wanted})")
    expect(shape[0] <= MOST_ROWS, path, f"{name} declares {shape[0]} rows; {MOST_ROWS} at most are read")


def numbers(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float32]:
    """Finite float32 of what was read. Raises StageError."""
    with np.errstate(over="ignore"):
        found = values.astype(np.float32)
    expect(bool(np.isfinite(found).all()), path, f"{name} holds values that are not finite numbers")
    return found


def commands(path: Path, name: str, told: NDArray[Any]) -> NDArray[np.float32]:
    """(T, N, 8) as told, (T, N * 8) or (T, N, 8). Raises StageError for what is no joint target in rad."""
    found = numbers(path, name, told).reshape(len(told), prod(told.shape[1:]) // COMMAND, COMMAND)
    beyond = within_limits(found)[1]
    expect(
        beyond < FARTHEST,
        path,
        f"{name} is up to {beyond:.3g} beyond the limits of a {DEFAULT.title}; expected absolute joint "
        "targets in rad (control mode pd_joint_pos) and a gripper from -1 to 1",
    )
    return found


def assumed_qpos(told: NDArray[np.float32]) -> NDArray[np.float32]:
    """Joints (..., 9) of arms that are where they are told to be (..., 8), fingers as far open as told."""
    fingers = DEFAULT.hand.opening_m(told[..., -1:]).astype(np.float32)
    return np.concatenate([told[..., :-1], *[fingers] * FINGERS], axis=-1)


def counted_subgoals(told: NDArray[np.float32]) -> tuple[NDArray[np.int16], list[list[str]]]:
    """(T, N) how often each gripper has changed in an episode (T, N, 8), and texts of these numbers.

    All begin open. It is what keypoints are, too: where an arm is when its gripper changes.
    """
    changed = np.diff(told[..., -1] > 0, axis=0, prepend=True)
    count = np.minimum(np.cumsum(changed, axis=0), np.iinfo(np.int16).max)
    texts = [[f"after {k} changes of the gripper" for k in range(most + 1)] for most in count.max(axis=0)]
    return count.astype(np.int16), texts


def kept(
    told: NDArray[np.float32], executed: NDArray[np.float32] | None, disturbed: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """`action` and `executed` of an episode: what is beyond a limit is meant at it, executed as it was."""
    return within_limits(told)[0], (told if executed is None else executed) if disturbed else None


def ordered(cameras: Iterable[str], agents: int) -> list[str]:
    """The cameras of a store in its order: global, those of the agents, others."""
    usual = camera_names("all", agents)
    return sorted(cameras, key=lambda name: (usual.index(name) if name in usual else len(usual), name))


def checked_name(path: Path, task: str) -> str:
    """The name of the task of a source. Raises ArgumentError where nothing tells it."""
    if not task:
        raise ArgumentError(f"{path} does not say of which task it is; say so, as in --task lift_barrier")
    return checked_task(task)


def digest_of(told: Sequence[NDArray[np.float32]], seeds: Sequence[int]) -> str:
    """Tells commands of episodes (T, N, 8) and their seeds from any others."""
    sha = hashlib.sha256()
    for seed, each in zip(seeds, told, strict=True):
        sha.update(f"{seed} {each.shape}".encode())
        sha.update(each.tobytes())
    return sha.hexdigest()[:16]


def bounds_note(told: Sequence[NDArray[np.float32]]) -> list[str]:
    """What is said of commands beyond their limits; nothing where there are none."""
    beyond = [within_limits(each)[1] for each in told]
    if not any(beyond):
        return []
    return [
        f"commands of {np.count_nonzero(beyond)} episodes are up to {max(beyond):.3g} beyond the limits of "
        "joints (rad) and grippers: action holds them at the limit, executed as they were"
    ]


def own_seeds(found: Sequence[int | None]) -> tuple[list[int], bool]:
    """The seeds of episodes, and whether all are known and differ; else numbers from 0."""
    known = [seed for seed in found if seed is not None]
    if len(known) == len(found) and len({*known}) == len(known):
        return known, True
    return [*range(len(found))], False


def listed(names: Sequence[str]) -> str:
    """The first of them."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
