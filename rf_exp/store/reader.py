"""What is in a store: episodes, and each array over all of them."""

import hashlib
import json
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.store.description import Description, Model, models
from rf_exp.store.integrity import blames
from rf_exp.store.layout import JUDGED, PICTURE_SHARD, array_of, extra_names, view
from rf_exp.types import NO_EXTRAS, Episode, Extras, Judged


class Reader:
    """The demonstrations in a Zarr group, in the order they were stored."""

    def __init__(self, path: Path, group: zarr.Group, attributes: dict[str, Any]) -> None:
        self.path = path
        self._group = group
        self._attrs = attributes
        self._ends = np.zeros(0, np.int64)
        self._seeds = np.zeros(0, np.int64)

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

    def first(self, episodes: int) -> Self:
        """The same store, for reading, as if it held only its first episodes.

        Raises ArgumentError when it holds fewer.
        """
        if not 0 <= episodes <= len(self):
            raise ArgumentError(f"{self.path} holds {len(self)} episodes; {episodes} were asked for")
        part = type(self)(self.path, self._group, self._attrs)
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
    def models(self) -> tuple[Model, ...]:
        """What is known of the robot of each agent."""
        return models(self._attrs)

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self._attrs["cameras"])

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects whose poses are kept."""
        return tuple(self._attrs["objects"])

    @property
    def disturbed(self) -> bool:
        """Whether what was executed differs from what was intended."""
        return bool(self._attrs.get("disturbed", False))

    @property
    def description(self) -> Description | None:
        """What the data are about; None in a store that was made without it."""
        return Description.of(self._attrs)

    @property
    def extras(self) -> Extras:
        """What is kept of the cameras beside pictures."""
        said = self.description
        return Extras(said.depth, bool(said.labels)) if said else NO_EXTRAS

    @cached_property
    def qpos(self) -> NDArray[np.float32]:
        """(T, N, D) measured joints, rad and metres."""
        return self._read("data/qpos")

    @cached_property
    def qvel(self) -> NDArray[np.float32]:
        """(T, N, D) measured joint velocities, rad/s and m/s."""
        return self._read("data/qvel")

    @cached_property
    def action(self) -> NDArray[np.float32]:
        """(T, N, A) joint targets, rad, and gripper command."""
        return self._read("data/action")

    @cached_property
    def executed(self) -> NDArray[np.float32]:
        """(T, N, A) what the arms were told: `action`, unless the demonstrations were disturbed."""
        return self._read("data/executed") if self.disturbed else self.action

    @cached_property
    def poses(self) -> dict[str, NDArray[np.float32]]:
        """Object -> (T, 7) position in m and quaternion w, x, y, z."""
        return {name: self._read(f"data/pose_{name}") for name in self.objects}

    @cached_property
    def subgoal(self) -> NDArray[np.int16]:
        """(T, N) index of what each agent is about in its texts in the certificate; -1 is not known."""
        return self._read("data/subgoal")

    @cached_property
    def judged(self) -> Judged | None:
        """How far each condition of success was met after each action; None without a description."""
        if "conditions" not in self._attrs:
            return None
        return Judged(
            tuple(self._attrs["conditions"]),
            **{name: self._read(f"data/condition_{name}") for name in JUDGED},
        )

    @property
    def extra_names(self) -> tuple[str, ...]:
        """`depth_<camera>` and `segmentation_<camera>` of what was asked for."""
        return extra_names(self._attrs)

    @cached_property
    def images(self) -> dict[str, zarr.Array[Any]]:
        """Camera -> Zarr array (T, H, W, 3) u8 of exactly the stored episodes."""
        return {camera: view(self._array(f"data/rgb_{camera}"), self.steps) for camera in self.cameras}

    @cached_property
    def certificates(self) -> list[dict[str, Any]]:
        """The certificate of the checks of each episode."""
        texts = self._read("meta/certificate", 0, len(self))
        with blames(self.path, "meta/certificate holds no JSON"):
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
            images={camera: self._read(f"data/rgb_{camera}", start, end) for camera in self.cameras},
            certificate=self.certificates[index],
            executed=self.executed[start:end] if self.disturbed else None,
            poses={name: values[start:end] for name, values in self.poses.items()},
            subgoal=self.subgoal[start:end],
            judged=self._judged_within(start, end),
            extras={name: self._read(f"data/{name}", start, end) for name in self.extra_names},
        )

    def _judged_within(self, start: int, end: int) -> Judged | None:
        if self.judged is None:
            return None
        return replace(self.judged, **{name: getattr(self.judged, name)[start:end] for name in JUDGED})

    def digest(self) -> str:
        """SHA-256 over the decoded qpos, action and pictures in order: same seeds, same digest."""
        sha = hashlib.sha256()
        for name in ("data/qpos", "data/action", *(f"data/rgb_{camera}" for camera in self.cameras)):
            sha.update(f"{name} {(self.steps, *self._array(name).shape[1:])}".encode())
            for start in range(0, self.steps, PICTURE_SHARD):
                sha.update(self._read(name, start, min(start + PICTURE_SHARD, self.steps)).tobytes())
        return sha.hexdigest()

    def _array(self, name: str) -> zarr.Array[Any]:
        return array_of(self._group, name)

    def _read(self, name: str, start: int = 0, end: int | None = None) -> NDArray[Any]:
        with blames(self.path, f"{name} cannot be read"):
            return np.asarray(self._array(name)[start : self.steps if end is None else end])
