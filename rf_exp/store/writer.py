"""Making a store, opening it, and adding episodes to it."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np

from rf_exp.artifacts import code, disk_full, expect_same, hold_folder, installed, plain
from rf_exp.errors import ArgumentError, StageError
from rf_exp.robots import Robot
from rf_exp.store import layout
from rf_exp.store.additions import additions
from rf_exp.store.description import Description, stated
from rf_exp.store.integrity import check_rows, opened
from rf_exp.store.reader import Reader
from rf_exp.types import CONTROL_HZ, Episode

PACKAGES = ("rf_exp", "numpy", "zarr", "mani-skill", "sapien", "pin", "coal", "toppra")
CACHED = ("qpos", "qvel", "action", "executed", "poses", "subgoal", "judged", "images", "certificates")


class Store(Reader):
    """Demonstrations of one task made by one configuration. Open it with `create` or `open`."""

    _lock: int | None = None  # descriptor that holds the right to write

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

        `identity` is the configuration that makes the data, as plain JSON values; `task`, `version`
        (of the success criteria) and `generator` (version of the code) in it become attributes of
        their own, beside the commit of the code. Pictures are (height, width, 3); without cameras
        both may be 0. `disturbed` demonstrations were executed otherwise than intended. With a
        `description` the store also holds times, the values of the conditions of success, and the
        depth and segmentation that it speaks of. `robots` are those of the agents; without them all are
        the usual one.

        Raises StageError when `path` exists or the disk is full, ArgumentError when nothing can be
        created there.
        """
        path = Path(path)
        if path.exists():
            raise StageError(f"{path} exists already; open it, delete it, or choose another `out`")
        size = {"agents": agents, "cameras": list(cameras), "height": height, "width": width}
        attributes = {**_provenance(identity), **size, "objects": list(objects), "disturbed": disturbed}
        attributes |= stated(robots)
        described = description.attributes() if description else {}
        _create(path, {**attributes, **described, "versions": installed(PACKAGES)})
        return cls.open(path, writable=True)

    @classmethod
    def open(
        cls, path: str | Path, identity: Mapping[str, object] | None = None, writable: bool = False
    ) -> Self:
        """An existing store, checked: layout, shapes, types, ends, seeds, and that every file answers.

        With `identity`, the store must have been made from exactly that configuration. With
        `writable`, the store is locked and rows of an interrupted append are cut off.

        Raises StageError saying what is damaged or different, and what to do, or that it is no store.
        """
        path = Path(path)
        group, attributes = opened(path, "r+" if writable else "r")
        store = cls(path, group, attributes)
        try:
            if writable:
                store._take()
            if identity is not None:
                expect_same(path, store.identity, identity, "delete it or choose another `out`")
            store._ends, store._seeds = check_rows(path, group, store.attrs)
            if writable:
                store._cut()
        except BaseException:
            store.close()
            raise
        return store

    def append(self, episode: Episode) -> None:
        """Store one more episode; when this returns it is there, when it raises it is not.

        Raises StageError for an episode that does not fit this store, and when the disk is full.
        """
        if self._lock is None:
            raise StageError(f"{self.path} is open for reading; open it with writable=True to append")
        rows = additions(self, episode)
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
        self._ends = np.append(self._ends, rows["meta/episode_ends"])
        self._seeds = np.append(self._seeds, rows["meta/seed"])
        for name in CACHED:
            self.__dict__.pop(name, None)  # read again when asked for

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

    def _take(self) -> None:
        """The right to write, which one process has at a time."""
        self._lock = hold_folder(self.path)
        if self._lock is None:
            raise StageError(f"{self.path} is being written by another process; wait for it or stop it")

    def _cut(self) -> None:
        """Remove what an interrupted append left behind."""
        for name in layout.layout(self.attrs):
            array = self._array(name)
            committed = self.steps if name.startswith("data/") else len(self)
            if array.shape[0] > committed:
                array.resize((committed, *array.shape[1:]))
        for leftover in self.path.rglob("*.partial"):
            leftover.unlink()


def _provenance(identity: Mapping[str, object]) -> dict[str, Any]:
    """The attributes that say of what, and with which code, data are made."""
    configuration = plain(identity)
    return {
        "format": layout.FORMAT,
        "task": configuration.get("task"),
        "criteria_version": configuration.get("version"),
        "generator": configuration.get("generator"),
        "commit": code(),
        "identity": configuration,
        "control_hz": CONTROL_HZ,
    }


def _create(path: Path, attributes: Mapping[str, Any]) -> None:
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


def _raise_full(path: Path, needed: int, doing: str, error: OSError, episodes: int = 0) -> NoReturn:
    free = shutil.disk_usage(path if path.exists() else path.parent).free
    raise StageError(
        f"no space left while {doing} in {path}: up to {needed} bytes needed, {free} bytes free "
        f"({error.strerror}); its {episodes} stored episodes are intact: make room and run the same "
        "command again"
    ) from error
