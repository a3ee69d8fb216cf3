"""The replay buffer: one Zarr 3 folder of demonstrations, written episode by episode.

    data/qpos (T, N, 9) f32      measured joints: rad for the arm, metres for the two fingers
    data/qvel (T, N, 9) f32      their velocities
    data/action (T, N, 8) f32    joint targets in rad + gripper command, as intended
    data/executed (T, N, 8) f32  what the arms were told, in a store of disturbed demonstrations
    data/rgb_<camera> (T, H, W, 3) u8
    data/pose_<object> (T, 7) f32  position in m and quaternion w, x, y, z, world frame
    data/subgoal (T, N) i16      what each agent is about: an index of its texts in the certificate's
                                 `subgoals`; -1 where that is not known
    meta/episode_ends (E,) i64   row after the last of each episode
    meta/seed (E,) i64, meta/certificate (E,) JSON text

An episode counts once `episode_ends` names it, and that is written last: whatever happens before
leaves surplus rows that readers ignore and the next writer cuts off. Every file is replaced
atomically, so a killed process never damages what was stored.

Pictures are compressed with plain zstd, 8 frames a chunk. The cameras stand still, so most of a
frame repeats the one before it, and zstd sees that when frames share a chunk; Blosc cuts chunks
into blocks too small for it.
"""

import errno
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from rf_exp.artifacts.files import whole
from rf_exp.artifacts.identity import differing, plain
from rf_exp.artifacts.provenance import commit, installed
from rf_exp.errors import ArgumentError, RfError, StageError
from rf_exp.types import CONTROL_HZ, Episode

FORMAT = 1
PICTURE_CHUNK, PICTURE_SHARD = 8, 256  # frames; a shard is one file
STATE_CHUNK, META_CHUNK = 1024, 256  # rows
JOINTS, COMMANDS = 9, 8  # values an agent in qpos and qvel, in action
POSE = 7  # values of an object
PACKAGES = ("rf_exp", "numpy", "zarr", "mani-skill", "sapien", "pin", "coal", "toppra")
ALWAYS_WRITE = {"write_empty_chunks": True}  # so that a missing file always means damage
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Store:
    """Demonstrations of one task made by one configuration. Open it with `create` or `open`."""

    def __init__(self, path: Path, group: zarr.Group, lock: int | None) -> None:
        self.path = path
        self._group = group
        self._lock = lock
        self._attrs: dict[str, Any] = dict(group.attrs)
        self._ends = np.zeros(0, np.int64)
        self._seeds = np.zeros(0, np.int64)

    # Opening and closing

    @classmethod
    def create(
        cls,
        path: str | Path,
        identity: Mapping[str, object],
        agents: int,
        cameras: Sequence[str],
        height: int,
        width: int,
        objects: Sequence[str] = (),
        disturbed: bool = False,
    ) -> "Store":
        """A new, empty store, opened for writing.

        `identity` is the configuration that makes the data, as plain JSON values; `task`, `version`
        (of the success criteria) and `generator` (version of the code) in it become attributes of
        their own, beside the commit of the code. Pictures are (height, width, 3); without cameras
        both may be 0. `disturbed` demonstrations were executed otherwise than intended.

        Raises StageError when `path` exists or the disk is full, ArgumentError when nothing can be
        created there.
        """
        path = Path(path)
        if path.exists():
            raise StageError(f"{path} exists already; open it, delete it, or choose another `out`")
        configuration = plain(identity)
        attributes = {
            "format": FORMAT,
            "task": configuration.get("task"),
            "criteria_version": configuration.get("version"),
            "generator": configuration.get("generator"),
            "commit": commit(),
            "identity": configuration,
            "control_hz": CONTROL_HZ,
            "agents": agents,
            "cameras": list(cameras),
            "height": height,
            "width": width,
            "objects": list(objects),
            "disturbed": disturbed,
            "versions": installed(PACKAGES),
        }
        try:
            with whole(path) as draft:
                _create(draft, attributes)
        except OSError as error:
            if path.exists():
                raise StageError(f"{path} was made by another process meanwhile; run again") from error
            if error.errno in DISK_FULL:
                _raise_full(path, 100_000, "creating the store", error)
            raise ArgumentError(
                f"cannot create a store at {path}: {error.strerror or error}; "
                "expected `out` to be a folder that can be written"
            ) from error
        return cls.open(path, writable=True)

    @classmethod
    def open(
        cls, path: str | Path, identity: Mapping[str, object] | None = None, writable: bool = False
    ) -> "Store":
        """An existing store, checked: layout, shapes, types, ends, seeds, and that every file answers.

        With `identity`, the store must have been made from exactly that configuration. With
        `writable`, the store is locked and rows of an interrupted append are cut off.

        Raises StageError saying what is damaged or different, and what to do.
        """
        path = Path(path)
        if not path.is_dir():
            raise StageError(f"no store at {path}; generate the data first (stages=[generate])")
        with _blames(path, "the store cannot be opened"):
            group = zarr.open_group(path, mode="r+" if writable else "r", zarr_format=3)
        store = cls(path, group, _lock(path) if writable else None)
        try:
            store._check_attributes()
            if identity is not None:
                store._check_identity(plain(identity))
            store._check_rows()
            if writable:
                store._cut()
        except BaseException:
            store.close()
            raise
        return store

    def close(self) -> None:
        """Give up the right to write; reading goes on."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()

    # What is in it

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self._ends)

    @property
    def steps(self) -> int:
        """Rows of all episodes together, T."""
        return int(self._ends[-1]) if len(self._ends) else 0

    def by_episode(self, values: NDArray) -> list[NDArray]:
        """Rows of all stored steps (T, ...) -> those of each episode."""
        return np.split(values[: self.steps], self.episode_ends[:-1])

    def first(self, episodes: int) -> "Store":
        """The same store, for reading, as if it held only its first episodes.

        Raises ArgumentError when it holds fewer.
        """
        if not 0 <= episodes <= len(self):
            raise ArgumentError(f"{self.path} holds {len(self)} episodes; {episodes} were asked for")
        part = Store(self.path, self._group, lock=None)
        part._ends, part._seeds = self._ends[:episodes], self._seeds[:episodes]
        return part

    @property
    def episode_ends(self) -> NDArray[np.int64]:
        """(E,) row after the last of each episode."""
        return self._ends.copy()

    @property
    def seeds(self) -> NDArray[np.int64]:
        """(E,) scene seed of each episode."""
        return self._seeds.copy()

    @property
    def identity(self) -> dict[str, Any]:
        """The configuration that made the data."""
        return self._attrs["identity"]

    @property
    def attrs(self) -> dict[str, Any]:
        """All attributes: task, identity, versions of packages and criteria, control rate, sizes."""
        return self._attrs

    @property
    def agents(self) -> int:
        return self._attrs["agents"]

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self._attrs["cameras"])

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects whose poses are kept."""
        return tuple(self._attrs.get("objects", ()))

    @property
    def disturbed(self) -> bool:
        """Whether what was executed differs from what was intended."""
        return bool(self._attrs.get("disturbed", False))

    @cached_property
    def qpos(self) -> NDArray[np.float32]:
        """(T, N, 9) measured joints, rad and metres."""
        return self._read("data/qpos")

    @cached_property
    def qvel(self) -> NDArray[np.float32]:
        """(T, N, 9) measured joint velocities, rad/s and m/s."""
        return self._read("data/qvel")

    @cached_property
    def action(self) -> NDArray[np.float32]:
        """(T, N, 8) joint targets, rad, and gripper command."""
        return self._read("data/action")

    @cached_property
    def executed(self) -> NDArray[np.float32]:
        """(T, N, 8) what the arms were told: `action`, unless the demonstrations were disturbed."""
        return self._read("data/executed") if self.disturbed else self.action

    @cached_property
    def poses(self) -> dict[str, NDArray[np.float32]]:
        """Object -> (T, 7) position in m and quaternion w, x, y, z; empty in an older store."""
        return {name: self._read(f"data/pose_{name}") for name in self.objects}

    @cached_property
    def subgoal(self) -> NDArray[np.int16]:
        """(T, N) index of what each agent is about in its texts in the certificate; -1 is not known."""
        if "objects" not in self._attrs:
            return np.full((self.steps, self.agents), -1, np.int16)
        return self._read("data/subgoal")

    @cached_property
    def pictures(self) -> dict[str, zarr.Array[Any]]:
        """Camera -> Zarr array (T, H, W, 3) u8 of exactly the stored episodes."""
        return {camera: _view(self._array(f"data/rgb_{camera}"), self.steps) for camera in self.cameras}

    @cached_property
    def certificates(self) -> list[dict[str, Any]]:
        """The certificate of the checks of each episode."""
        texts = self._read("meta/certificate", 0, len(self))
        with _blames(self.path, "meta/certificate holds no JSON"):
            return [json.loads(text) for text in texts]

    def episode(self, index: int) -> Episode:
        """One episode, read into memory. Raises IndexError beyond the last."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"episode {index} of {len(self)} in {self.path}")
        index %= len(self)
        start, end = int(self._ends[index - 1]) if index else 0, int(self._ends[index])
        return Episode(
            task=str(self._attrs["task"]),
            seed=int(self._seeds[index]),
            qpos=self.qpos[start:end],
            qvel=self.qvel[start:end],
            action=self.action[start:end],
            pictures={camera: self._read(f"data/rgb_{camera}", start, end) for camera in self.cameras},
            certificate=self.certificates[index],
            executed=self.executed[start:end] if self.disturbed else None,
            poses={name: values[start:end] for name, values in self.poses.items()},
            subgoal=self.subgoal[start:end],
        )

    def digest(self) -> str:
        """SHA-256 over the decoded qpos, action and pictures in order: same seeds, same digest."""
        sha = hashlib.sha256()
        for name in ("data/qpos", "data/action", *(f"data/rgb_{camera}" for camera in self.cameras)):
            sha.update(f"{name} {(self.steps, *self._array(name).shape[1:])}".encode())
            for start in range(0, self.steps, PICTURE_SHARD):
                sha.update(self._read(name, start, min(start + PICTURE_SHARD, self.steps)).tobytes())
        return sha.hexdigest()

    # Writing

    def append(self, episode: Episode) -> None:
        """Store one more episode; when this returns it is there, when it raises it is not.

        Raises StageError for an episode that does not fit this store, and when the disk is full.
        """
        if self._lock is None:
            raise StageError(f"{self.path} is open for reading; open it with writable=True to append")
        rows = self._rows(episode)
        start = {"data": self.steps, "meta": len(self)}
        try:
            for name, values in rows.items():  # `meta/episode_ends` is the last: the commit
                _write(self._array(name), start[name.split("/")[0]], values)
        except OSError as error:
            if error.errno in DISK_FULL:
                needed = sum(values.nbytes for values in rows.values())
                doing = f"storing the episode of seed {episode.seed}"
                _raise_full(self.path, needed, doing, error, len(self))
            raise StageError(
                f"cannot write the episode of seed {episode.seed} to {self.path}: {error.strerror or error}; "
                f"its {len(self)} stored episodes are intact"
            ) from error
        self._ends = np.append(self._ends, rows["meta/episode_ends"])
        self._seeds = np.append(self._seeds, rows["meta/seed"])
        for name in ("qpos", "qvel", "action", "executed", "poses", "subgoal", "pictures", "certificates"):
            self.__dict__.pop(name, None)  # read again when asked for

    def _rows(self, episode: Episode) -> dict[str, NDArray[Any]]:
        """Array name -> the rows that the episode adds, checked; in the order they are written."""
        label = f"episode of seed {episode.seed}"
        if episode.task != (task := self._attrs["task"]) and isinstance(task, str):
            raise StageError(f"{label} is of task {episode.task!r}; {self.path} holds {task!r}")
        if episode.seed in self._seeds:
            raise StageError(f"{label} is stored already in {self.path}; every seed is stored once")
        if set(episode.pictures) != set(self.cameras):
            raise StageError(
                f"{label} has pictures of {sorted(episode.pictures)}; "
                f"{self.path} expects {sorted(self.cameras)}"
            )
        steps = len(episode.qpos)
        if steps == 0:
            raise StageError(f"{label} has no steps; expected at least one")
        if set(episode.poses) != set(self.objects):
            raise StageError(
                f"{label} has poses of {sorted(episode.poses)}; {self.path} expects {sorted(self.objects)}"
            )
        if (episode.executed is not None) != self.disturbed:
            found, expected = ("no", "some") if self.disturbed else ("some", "no")
            raise StageError(
                f"{label} has {found} executed actions of its own; {self.path} expects {expected}"
            )
        data: dict[str, NDArray[Any]] = {
            "data/qpos": episode.qpos,
            "data/qvel": episode.qvel,
            "data/action": episode.action,
        }
        data |= {f"data/rgb_{camera}": episode.pictures[camera] for camera in self.cameras}
        data |= {f"data/pose_{name}": episode.poses[name] for name in self.objects}
        if episode.executed is not None:
            data["data/executed"] = episode.executed
        layout = _layout(self._attrs)
        if "data/subgoal" in layout:
            unknown = np.full((steps, self.agents), -1, np.int16)
            data["data/subgoal"] = unknown if episode.subgoal is None else episode.subgoal
        for name, values in data.items():
            shape, dtype = layout[name]
            if values.shape != (steps, *shape) or values.dtype != np.dtype(dtype):
                raise StageError(
                    f"{name} of the {label} is {values.dtype} {values.shape}; "
                    f"expected {dtype} {(steps, *shape)}"
                )
            if dtype == "float32" and not np.isfinite(values).all():
                raise StageError(f"{name} of the {label} holds values that are not finite numbers")
        certificate = json.dumps(plain(episode.certificate), sort_keys=True)
        return data | {
            "meta/seed": np.array([episode.seed], np.int64),
            "meta/certificate": np.array([certificate], np.dtypes.StringDType()),
            "meta/episode_ends": np.array([self.steps + steps], np.int64),
        }

    def _cut(self) -> None:
        """Remove what an interrupted append left behind."""
        for name in _layout(self._attrs):
            array = self._array(name)
            committed = self.steps if name.startswith("data/") else len(self)
            if array.shape[0] > committed:
                array.resize((committed, *array.shape[1:]))
        for leftover in self.path.rglob("*.partial"):
            leftover.unlink()

    # Reading and checking

    def _array(self, name: str) -> zarr.Array[Any]:
        array = self._group[name]
        assert isinstance(array, zarr.Array)
        return array

    def _read(self, name: str, start: int = 0, end: int | None = None) -> NDArray[Any]:
        with _blames(self.path, f"{name} cannot be read"):
            return np.asarray(self._array(name)[start : self.steps if end is None else end])

    def _check_attributes(self) -> None:
        wanted = {"format", "task", "identity", "agents", "cameras", "height", "width", "control_hz"}
        if missing := sorted(wanted - set(self._attrs)):
            raise _damaged(self.path, f"attributes {', '.join(missing)} are missing")
        for key, expected in (("format", FORMAT), ("control_hz", CONTROL_HZ)):
            if self._attrs[key] != expected:
                raise StageError(
                    f"{self.path} has {key} {self._attrs[key]}; this version reads {expected}; "
                    "generate the data again"
                )

    def _check_identity(self, asked: Mapping[str, object]) -> None:
        if differences := differing(self.identity, asked):
            raise StageError(
                f"{self.path} was made from another configuration ({'; '.join(differences)}); "
                "delete it or choose another `out`"
            )

    def _check_rows(self) -> None:
        """Shapes, types, lengths, and one read from every file."""
        layout = _layout(self._attrs)
        for name, (shape, dtype) in layout.items():
            with _blames(self.path, f"{name} is missing or cannot be opened"):
                array = self._array(name)
            if array.shape[1:] != shape or array.dtype != np.dtype(dtype):
                found = f"{array.dtype} {('T', *array.shape[1:])}"
                raise _damaged(self.path, f"{name} is {found}, expected {dtype} {('T', *shape)}")
        episodes = self._array("meta/episode_ends").shape[0]
        self._check_length("meta/episode_ends", episodes)
        self._ends = self._read("meta/episode_ends", 0, episodes)
        if np.any(np.diff(self._ends, prepend=0) <= 0):
            raise _damaged(self.path, f"meta/episode_ends does not rise: {self._ends.tolist()}")
        for name in layout:
            self._check_length(name, self.steps if name.startswith("data/") else episodes)
        self._seeds = self._read("meta/seed", 0, episodes)
        values, counts = np.unique(self._seeds, return_counts=True)
        if repeated := values[counts > 1].tolist():
            raise _damaged(self.path, f"meta/seed holds seeds more than once: {repeated}")

    def _check_length(self, name: str, expected: int) -> None:
        array = self._array(name)
        if array.shape[0] < expected:
            raise _damaged(self.path, f"{name} has {array.shape[0]} rows, {expected} expected")
        rows = (array.shards or array.chunks)[0]  # of one file
        for first in range(0, expected, rows):
            key = array.metadata.encode_chunk_key((first // rows, *[0] * (array.ndim - 1)))
            file = self.path / name / key
            # Zarr takes a missing file for zeros: look, then read its last row.
            try:
                if not file.is_file():
                    raise FileNotFoundError(f"file {file.relative_to(self.path)} is missing")
                array[min(first + rows, expected) - 1]
            except Exception as error:  # whatever a decoder raises on damaged bytes
                last = min(first + rows, expected) - 1
                raise _damaged(
                    self.path,
                    f"{name} has only {first} readable rows, {expected} expected: "
                    f"rows {first} to {last} in file {key} cannot be read ({error})",
                ) from error


def _layout(attributes: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Array name -> (shape of one row, dtype), the whole layout of a store."""
    agents, picture = attributes["agents"], (attributes["height"], attributes["width"], 3)
    executed = {"data/executed": ((agents, COMMANDS), "float32")} if attributes.get("disturbed") else {}
    subgoal = {"data/subgoal": ((agents,), "int16")} if "objects" in attributes else {}
    return {
        "data/qpos": ((agents, JOINTS), "float32"),
        "data/qvel": ((agents, JOINTS), "float32"),
        "data/action": ((agents, COMMANDS), "float32"),
        **executed,
        **subgoal,
        **{f"data/pose_{name}": ((POSE,), "float32") for name in attributes.get("objects", ())},
        **{f"data/rgb_{camera}": (picture, "uint8") for camera in attributes["cameras"]},
        "meta/seed": ((), "int64"),
        "meta/certificate": ((), np.dtypes.StringDType()),
        "meta/episode_ends": ((), "int64"),
    }


def empty_like(path: Path, attributes: Mapping[str, Any]) -> None:
    """A new store without episodes, with all attributes of another, also those that say who made it."""
    with whole(path) as draft:
        _create(draft, dict(attributes))


def _create(path: Path, attributes: dict[str, Any]) -> None:
    """A new folder with all arrays of the layout, empty."""
    group = zarr.create_group(path, attributes=attributes)
    for name, (shape, dtype) in _layout(attributes).items():
        picture = name.startswith("data/rgb_")
        rows = PICTURE_CHUNK if picture else META_CHUNK if name.startswith("meta/") else STATE_CHUNK
        group.create_array(
            name,
            shape=(0, *shape),
            dtype=dtype,
            chunks=(rows, *shape),
            shards=(PICTURE_SHARD, *shape) if picture else None,
            filters=None,
            compressors=ZstdCodec(level=3, checksum=True),
        )


def _view(array: zarr.Array[Any], rows: int) -> zarr.Array[Any]:
    """The array as if it had that many rows; the stored shape stays."""
    shaped = array.metadata.update_shape((rows, *array.shape[1:]))
    return zarr.Array(zarr.AsyncArray(shaped, array.store_path, ALWAYS_WRITE))  # pyright: ignore


def _write(array: zarr.Array[Any], start: int, values: NDArray[Any]) -> None:
    """Put rows behind `start`, and only then let the stored shape include them."""
    end = start + len(values)
    _view(array, end)[start:end] = values
    array.resize((end, *array.shape[1:]))


@contextmanager
def _blames(path: Path, what: str) -> Iterator[None]:
    """Turns whatever a decoder raises on damaged bytes into a StageError that names the array."""
    try:
        yield
    except RfError:
        raise
    except Exception as error:
        raise _damaged(path, f"{what} ({type(error).__name__}: {error})") from error


def _damaged(path: Path, what: str) -> StageError:
    return StageError(
        f"{path} is damaged: {what}; restore it from a copy, keep what is "
        f"whole with `python -m rf_exp.rescue {path}`, or delete it and generate again"
    )


def _raise_full(path: Path, needed: int, doing: str, error: OSError, episodes: int = 0) -> NoReturn:
    free = shutil.disk_usage(path if path.exists() else path.parent).free
    raise StageError(
        f"no space left while {doing} in {path}: up to {needed} bytes needed, {free} bytes free "
        f"({error.strerror}); its {episodes} stored episodes are intact: make room and run the same "
        "command again"
    ) from error


def _lock(path: Path) -> int:
    """Only one process writes a store; the lock ends with its process."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise StageError(f"{path} is being written by another process; wait for it or stop it") from error
    return descriptor
