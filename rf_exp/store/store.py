"""Store: reads episodes and whole arrays, and appends episodes."""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.artifacts import code_version, disk_full, expect_same, lock_folder, package_versions, plain
from rf_exp.errors import ArgumentError, StageError
from rf_exp.robots import Robot
from rf_exp.store import layout
from rf_exp.store.integrity import check_rows, open_group, raising_damage, times_stored
from rf_exp.store.layout import JUDGED, PICTURE_SHARD, Description, get_array, view
from rf_exp.types import CONTROL_HZ, NO_EXTRAS, Episode, Extras, Judged

PACKAGES = ("rf_exp", "numpy", "zarr", "mani-skill", "sapien", "pin", "coal", "toppra")


class Store:
    """Demonstrations of one task made by one configuration, in their order. `create` or `open` one."""

    def __init__(self, path: Path, group: zarr.Group, attributes: dict[str, Any]) -> None:
        self.path = path
        self.attrs = attributes  # task, identity, versions of packages and criteria, control rate, sizes
        self.identity: dict[str, Any] = attributes["identity"]  # the configuration that made the data
        self.agents: int = attributes["agents"]
        self.models = layout.models(attributes)  # robot of each agent
        self.cameras: tuple[str, ...] = tuple(attributes["cameras"])
        self.objects: tuple[str, ...] = tuple(attributes["objects"])  # whose poses are kept
        self.disturbed = bool(attributes.get("disturbed"))  # executed actions differ from intended ones
        self.description = Description.of(attributes)  # None in a store that was made without it
        self.extra_names = layout.extra_names(attributes)  # `depth_<camera>`, `segmentation_<camera>`
        self.episode_ends = np.zeros(0, np.int64)  # (E,) row after the last of each episode
        self.seeds = np.zeros(0, np.int64)  # (E,) scene seed of each episode
        self._group = group
        self._cache: dict[str, NDArray[Any]] = {}  # cached arrays, until an episode is appended
        self._lock: int | None = None  # descriptor that holds the write lock

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
        description: Description | None = None,
        robots: Sequence[Robot] = (),
    ) -> Self:
        """A new, empty store, opened for writing.

        `identity` is the configuration that makes the data, as plain JSON values. Pictures are (height,
        width, 3), 0 without cameras. `disturbed`: executed actions differ from intended ones. With a
        `description` the store also holds times, the conditions of success, depth and segmentation. Without
        `robots` all agents have the default robot.

        Raises StageError when `path` exists or the disk is full, ArgumentError where it cannot be written.
        """
        path, configuration = Path(path), plain(identity)
        if path.exists():
            raise StageError(f"{path} exists already; open it, delete it, or choose another `out`")
        attributes = {
            "format": layout.FORMAT,
            "task": configuration.get("task"),
            "criteria_version": configuration.get("version"),
            "generator": configuration.get("generator"),
            "commit": code_version(),
            "identity": configuration,
            "control_hz": CONTROL_HZ,
            "agents": agents,
            "cameras": list(cameras),
            "height": height,
            "width": width,
            "objects": list(objects),
            "disturbed": disturbed,
            **layout.robot_attributes(robots),
            **(description.attributes() if description else {}),
            "versions": package_versions(PACKAGES),
        }
        try:
            layout.empty_like(path, attributes)
        except OSError as error:
            if path.exists():
                raise StageError(f"{path} was made by another process meanwhile; run again") from error
            if disk_full(error):
                _raise_full(path, 100_000, "creating the store", error)
            raise ArgumentError(
                f"cannot create a store at {path}: {error.strerror or error}; "
                "expected `out` to be a folder that can be written"
            ) from error
        return cls.open(path, writable=True)

    @classmethod
    def open(
        cls, path: str | Path, identity: Mapping[str, object] | None = None, writable: bool = False
    ) -> Self:
        """Opens a store and checks layout, shapes, types, ends, seeds, and that every file can be read.

        Its identity must equal `identity`, if given. A writable store is locked, and rows of an interrupted
        append are cut off. Raises StageError saying what is damaged or different, and what to do.
        """
        path = Path(path)
        store = cls(path, *open_group(path, "r+" if writable else "r"))
        try:
            if writable:
                store._lock = lock_folder(path)
                if store._lock is None:
                    raise StageError(f"{path} is being written by another process; wait for it or stop it")
            if identity is not None:
                expect_same(path, store.identity, identity, "delete it or choose another `out`")
            store.episode_ends, store.seeds = check_rows(path, store._group, store.attrs)
            if writable:
                store._truncate_uncommitted()
        except BaseException:
            store.close()
            raise
        return store

    def _truncate_uncommitted(self) -> None:
        for name in layout.layout(self.attrs):
            array = self._array(name)
            committed = self.steps if name.startswith("data/") else len(self)
            if array.shape[0] > committed:
                array.resize((committed, *array.shape[1:]))
        for leftover in self.path.rglob("*.partial"):
            leftover.unlink()

    def append(self, episode: Episode) -> None:
        """Appends an episode: it is stored if this returns, and not stored if it raises.

        Raises StageError for one that does not fit, and when the disk is full.
        """
        if self._lock is None:
            raise StageError(f"{self.path} is open for reading; open it with writable=True to append")
        rows = self._rows_of(episode)
        start = {"data": self.steps, "meta": len(self)}
        try:
            for name, values in rows.items():  # `meta/episode_ends` is the last: the commit
                layout.write(self._array(name), start[name.split("/")[0]], values)
        except OSError as error:
            if disk_full(error):
                needed = sum(values.nbytes for values in rows.values())
                doing = f"storing the episode of seed {episode.seed}"
                _raise_full(self.path, needed, doing, error, len(self))
            raise StageError(
                f"cannot write the episode of seed {episode.seed} to {self.path}: {error.strerror or error}; "
                f"its {len(self)} stored episodes are intact"
            ) from error
        self.episode_ends = np.append(self.episode_ends, rows["meta/episode_ends"])
        self.seeds = np.append(self.seeds, rows["meta/seed"])
        self._cache.clear()
        for name in ("images", "certificates"):
            self.__dict__.pop(name, None)  # cached properties: read again on demand

    def _rows_of(self, episode: Episode) -> dict[str, NDArray[Any]]:
        """Array name -> the rows that an episode adds, in the order of writing. Raises StageError."""
        label, steps = f"episode of seed {episode.seed}", len(episode.qpos)
        self._require_fit(episode, label)
        data: dict[str, Any] = {"qpos": episode.qpos, "qvel": episode.qvel, "action": episode.action}
        data |= {f"rgb_{camera}": episode.images[camera] for camera in self.cameras}
        data |= {f"pose_{name}": episode.poses[name] for name in self.objects}
        if episode.executed is not None:
            data["executed"] = episode.executed
        unknown = np.full((steps, self.agents), -1, np.int16)
        data["subgoal"] = unknown if episode.subgoal is None else episode.subgoal
        if "conditions" in self.attrs:
            data["time_s"] = np.arange(steps) / CONTROL_HZ
            data |= {f"condition_{name}": getattr(episode.judged, name) for name in JUDGED}
        data |= episode.extras
        wanted = layout.layout(self.attrs)
        for name, values in data.items():
            shape, dtype = wanted[f"data/{name}"]
            if values.shape != (steps, *shape) or values.dtype != np.dtype(dtype):
                raise StageError(
                    f"data/{name} of the {label} is {values.dtype} {values.shape}; "
                    f"expected {dtype} {(steps, *shape)}"
                )
            if dtype == "float32" and not np.isfinite(values).all():
                raise StageError(f"data/{name} of the {label} holds values that are not finite numbers")
        certificate = json.dumps(plain(episode.certificate), sort_keys=True)
        return {f"data/{name}": values for name, values in data.items()} | {
            "meta/seed": np.array([episode.seed], np.int64),
            "meta/certificate": np.array([certificate], np.dtypes.StringDType()),
            "meta/episode_ends": np.array([self.steps + steps], np.int64),
        }

    def _require_fit(self, episode: Episode, label: str) -> None:
        if episode.task != (task := self.attrs["task"]) and isinstance(task, str):
            raise StageError(f"{label} is of task {episode.task!r}; {self.path} holds {task!r}")
        times = times_stored(self.identity)
        if np.count_nonzero(self.seeds == episode.seed) >= times:
            often = "once" if times == 1 else f"{times} times"
            raise StageError(f"{label} is stored already in {self.path}; every seed is stored {often}")
        if len(episode.qpos) == 0:
            raise StageError(f"{label} has no steps; expected at least one")
        conditions = self.attrs.get("conditions")
        judged_conditions = list(episode.judged.names if episode.judged else ())
        present, expected = ("some", "no") if episode.executed is not None else ("no", "some")
        for what, found, wanted in (
            ("has images of", sorted(episode.images), sorted(self.cameras)),
            ("has poses of", sorted(episode.poses), sorted(self.objects)),
            ("has depth and segmentation", sorted(episode.extras), sorted(self.extra_names)),
            ("is judged by", judged_conditions, judged_conditions if conditions is None else conditions),
        ):
            if found != wanted:
                raise StageError(f"{label} {what} {found}; {self.path} expects {wanted}")
        if (episode.executed is not None) != self.disturbed:
            raise StageError(
                f"{label} has {present} executed actions of its own; {self.path} expects {expected}"
            )

    def close(self) -> None:
        """Releases the write lock; reading remains possible."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self.episode_ends)

    @property
    def steps(self) -> int:
        """Rows of all episodes together, T."""
        return int(self.episode_ends[-1]) if len(self.episode_ends) else 0

    def by_episode(self, values: NDArray) -> list[NDArray]:
        """Rows of all stored steps (T, ...) -> those of each episode."""
        return np.split(values[: self.steps], self.episode_ends[:-1])

    def first(self, episodes: int) -> Self:
        """A read-only view of the first `episodes` episodes. Raises ArgumentError."""
        if not 0 <= episodes <= len(self):
            raise ArgumentError(f"{self.path} holds {len(self)} episodes; {episodes} were asked for")
        part = type(self)(self.path, self._group, self.attrs)
        part.episode_ends, part.seeds = self.episode_ends[:episodes], self.seeds[:episodes]
        return part

    @property
    def extras(self) -> Extras:
        """Whether depth and segmentation are stored."""
        description = self.description
        return Extras(description.depth, bool(description.labels)) if description else NO_EXTRAS

    @property
    def qpos(self) -> NDArray[np.float32]:
        """(T, N, D) measured joints, rad and metres."""
        return self._read_all("qpos")

    @property
    def qvel(self) -> NDArray[np.float32]:
        """(T, N, D) measured joint velocities, rad/s and m/s."""
        return self._read_all("qvel")

    @property
    def action(self) -> NDArray[np.float32]:
        """(T, N, A) joint targets, rad, and gripper command."""
        return self._read_all("action")

    @property
    def executed(self) -> NDArray[np.float32]:
        """(T, N, A) executed commands: `action`, unless the demonstrations were disturbed."""
        return self._read_all("executed") if self.disturbed else self.action

    @property
    def poses(self) -> dict[str, NDArray[np.float32]]:
        """Object -> (T, 7) position in m and quaternion w, x, y, z."""
        return {name: self._read_all(f"pose_{name}") for name in self.objects}

    @property
    def subgoal(self) -> NDArray[np.int16]:
        """(T, N) current subgoal of each agent: index into its texts in the certificate; -1: unknown."""
        return self._read_all("subgoal")

    @property
    def judged(self) -> Judged | None:
        """How far each condition of success was met after each action; None without a description."""
        conditions = self.attrs.get("conditions")
        return None if conditions is None else layout.read_judged(conditions, self._read_all)

    @cached_property
    def images(self) -> dict[str, zarr.Array[Any]]:
        """Camera -> Zarr array (T, H, W, 3) u8 of exactly the stored episodes."""
        return {camera: view(self._array(f"data/rgb_{camera}"), self.steps) for camera in self.cameras}

    @cached_property
    def certificates(self) -> list[dict[str, Any]]:
        """The certificate of the checks of each episode."""
        texts = self._read("meta/certificate", 0, len(self))
        with raising_damage(self.path, "meta/certificate holds no JSON"):
            return [json.loads(text) for text in texts]

    def episode(self, index: int) -> Episode:
        """One episode, read into memory. Raises IndexError beyond the last."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"episode {index} of {len(self)} in {self.path}")
        index %= len(self)
        start, end = int(self.episode_ends[index - 1]) if index else 0, int(self.episode_ends[index])

        def rows(name: str) -> NDArray[Any]:
            is_large = layout.is_picture(f"data/{name}")
            return self._read(f"data/{name}", start, end) if is_large else self._read_all(name)[start:end]

        return layout.build_episode(
            self.attrs, int(self.seeds[index]), lambda: self.certificates[index], rows
        )

    def digest(self) -> str:
        """SHA-256 over the decoded qpos, action and pictures in order: same seeds, same digest."""
        sha = hashlib.sha256()
        for name in ("data/qpos", "data/action", *(f"data/rgb_{camera}" for camera in self.cameras)):
            sha.update(f"{name} {(self.steps, *self._array(name).shape[1:])}".encode())
            for start in range(0, self.steps, PICTURE_SHARD):
                sha.update(self._read(name, start, min(start + PICTURE_SHARD, self.steps)).tobytes())
        return sha.hexdigest()

    def _read_all(self, name: str) -> NDArray[Any]:
        if name not in self._cache:
            self._cache[name] = self._read(f"data/{name}")
        return self._cache[name]

    def _array(self, name: str) -> zarr.Array[Any]:
        return get_array(self._group, name)

    def _read(self, name: str, start: int = 0, end: int | None = None) -> NDArray[Any]:
        with raising_damage(self.path, f"{name} cannot be read"):
            return np.asarray(self._array(name)[start : self.steps if end is None else end])


def _raise_full(path: Path, needed: int, doing: str, error: OSError, episodes: int = 0) -> NoReturn:
    free = shutil.disk_usage(path if path.exists() else path.parent).free
    raise StageError(
        f"no space left while {doing} in {path}: up to {needed} bytes needed, {free} bytes free "
        f"({error.strerror}); its {episodes} stored episodes are intact: make room and run the same "
        "command again"
    ) from error
