"""Replay buffers: arrays over the rows of all episodes, concatenated, and the row after the last of each.

Diffusion Policy keeps them in Zarr, Policy-Lightning in HDF5. Most hold commands, but no measured joints.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.data.importing.source import (
    LARGEST_PX,
    MOST_AGENTS,
    Contents,
    Source,
    assumed_qpos,
    bounds_note,
    counted_subgoals,
    digest_of,
    expect,
    kept,
    ordered,
    refused,
)
from rf_exp.data.release import within_limits
from rf_exp.tasks import camera_of
from rf_exp.types import Episode

LACKS = ("poses", "calibration", "velocities", "success", "seeds", "subgoals", "certificates")
CHANNELS = 3


@dataclass(frozen=True)
class Frames:
    """Pictures of a camera, u8, in a source, read on demand."""

    path: Path
    name: str  # of the array in the source
    shape: tuple[int, ...]  # (T, 3, H, W) or (T, H, W, 3)
    read: Callable[[int, int], NDArray[Any]]  # (start, end) -> rows

    @property
    def first(self) -> bool:
        """Whether channels precede height and width. Raises StageError where the shape is ambiguous."""
        there = [axis for axis in (1, 3) if self.shape[axis] == CHANNELS]
        if len(there) != 1:
            expected = "(T, 3, H, W) or (T, H, W, 3), and no picture 3 pixels high or wide"
            raise refused(self.path, f"{self.name} has shape {self.shape}; expected {expected}")
        return there[0] == 1

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width."""
        high, wide = self.shape[2:] if self.first else self.shape[1:3]
        if not (0 < high <= LARGEST_PX and 0 < wide <= LARGEST_PX):
            raise refused(
                self.path, f"{self.name} has pictures of {high} x {wide}; {LARGEST_PX} px at most are read"
            )
        return high, wide

    def rows(self, start: int, end: int) -> NDArray[np.uint8]:
        """(end - start, H, W, 3)."""
        found = self.read(start, end)
        return np.ascontiguousarray(np.moveaxis(found, 1, -1) if self.first else found)


def cameras_of(frames: Mapping[str, Frames], agents: int) -> tuple[dict[str, Frames], list[str]]:
    """Cameras by our names, all of one picture size, and notes on those left out.

    The size is that of the first agent's own camera, or else of the first camera.
    """
    found: dict[str, Frames] = {}
    notes = []
    for name in sorted(frames):
        camera = camera_of(name, agents)
        if camera in found:
            notes.append(f"camera {name} was left out: {found[camera].name} is camera {camera} already")
        else:
            found[camera] = frames[name]
    if found:
        size = found.get("agent1", next(iter(found.values()))).size_px
        for camera in [camera for camera, each in found.items() if each.size_px != size]:
            other = found.pop(camera)
            notes.append(
                f"camera {other.name} was left out: its pictures are {other.size_px} px, others {size}"
            )
    return {camera: found[camera] for camera in ordered(found, agents)}, notes


class Flat(Source):
    """Source of demonstrations kept as arrays over all rows."""

    def __init__(
        self,
        path: Path,
        form: str,
        task: str,
        told: NDArray[np.float32],
        ends: NDArray[np.integer],
        frames: Mapping[str, Frames],
        state: NDArray[np.float32] | None = None,
        notes: Sequence[str] = (),
        close: Callable[[], object] = lambda: None,
    ) -> None:
        """`told`: commands (T, N, 8); `state`: measured joints (T, N, 9); `ends` (E,): row after an episode.

        Raises StageError for arrays of different lengths, and for ends that do not rise.
        """
        agents = told.shape[1]
        arms = f"it has commands of {agents} arms; expected 1 to {MOST_AGENTS}"
        expect(0 < agents <= MOST_AGENTS, path, arms)
        expect(len(ends) > 0, path, "episode_ends is empty")
        rising = bool((np.diff(ends.astype(np.int64), prepend=0) > 0).all())
        expect(rising, path, f"episode_ends does not rise from above 0: {ends[:8].tolist()}")
        count, steps = len(told), int(ends[-1])
        expect(steps <= count, path, f"episode_ends names {steps} rows; there are commands of {count}")
        self._frames, left_out = cameras_of(frames, agents)
        for each in self._frames.values():
            rows = f"{each.name} has {each.shape[0]} rows, the commands {count}"
            expect(each.shape[0] == count, path, f"{rows}; which of them lack is unknown")
        surplus = [f"{count - steps} rows behind the last episode were left out"] if count > steps else []
        self._ends = ends.astype(np.int64).tolist()
        self._starts = [0, *self._ends[:-1]]
        self._told, self._state, self._close = told, state, close
        episodes = [told[start:end] for start, end in zip(self._starts, self._ends, strict=True)]
        seeds = [*range(len(episodes))]
        self.contents = Contents(
            form=form,
            task=task,
            agents=agents,
            episodes=[f"episode {seed}" for seed in seeds],
            seeds=seeds,
            steps=[len(each) for each in episodes],
            cameras=tuple(self._frames),
            size_px=next((each.size_px for each in self._frames.values()), (0, 0)),
            told=digest_of(episodes, seeds),
            disturbed=within_limits(told[:steps])[1] > 0,
            missing=[*LACKS, *["pictures"] * (not self._frames), *["measured joints"] * (state is None)],
            notes=[*notes, *left_out, *surplus, *bounds_note(episodes)],
        )

    def episode(self, index: int) -> Episode:
        start, end = self._starts[index], self._ends[index]
        told = self._told[start:end]
        qpos = assumed_qpos(told) if self._state is None else self._state[start:end]
        subgoal, texts = counted_subgoals(told)
        action, executed = kept(told, None, self.contents.disturbed)
        return Episode(
            task=self.contents.task,
            seed=self.contents.seeds[index],
            qpos=qpos,
            qvel=np.zeros_like(qpos),
            action=action,
            executed=executed,
            images={camera: each.rows(start, end) for camera, each in self._frames.items()},
            subgoal=subgoal,
            certificate={"imported": self.contents.episodes[index], "subgoals": texts},
        )

    def close(self) -> None:
        self._close()
