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
    action_and_executed,
    assumed_qpos,
    bounds_note,
    counted_subgoals,
    digest_commands,
    import_error,
    require,
    sort_cameras,
)
from rf_exp.data.release import within_limits
from rf_exp.tasks import camera_from_release
from rf_exp.types import Episode

MISSING = ("poses", "calibration", "velocities", "success", "seeds", "subgoals", "certificates")
CHANNELS = 3


@dataclass(frozen=True)
class Frames:
    """Pictures of a camera, u8, in a source, read on demand."""

    path: Path
    name: str  # of the array in the source
    shape: tuple[int, ...]  # (T, 3, H, W) or (T, H, W, 3)
    read: Callable[[int, int], NDArray[Any]]  # (start, end) -> rows

    @property
    def channels_first(self) -> bool:
        """Whether channels precede height and width. Raises StageError where the shape is ambiguous."""
        axes = [axis for axis in (1, 3) if self.shape[axis] == CHANNELS]
        if len(axes) != 1:
            expected = "(T, 3, H, W) or (T, H, W, 3), and no picture 3 pixels high or wide"
            raise import_error(self.path, f"{self.name} has shape {self.shape}; expected {expected}")
        return axes[0] == 1

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.shape[2:] if self.channels_first else self.shape[1:3]
        if not (0 < height <= LARGEST_PX and 0 < width <= LARGEST_PX):
            raise import_error(
                self.path, f"{self.name} has pictures of {height} x {width}; {LARGEST_PX} px at most are read"
            )
        return height, width

    def rows(self, start: int, end: int) -> NDArray[np.uint8]:
        """(end - start, H, W, 3)."""
        rows = self.read(start, end)
        return np.ascontiguousarray(np.moveaxis(rows, 1, -1) if self.channels_first else rows)


def select_cameras(frames: Mapping[str, Frames], agents: int) -> tuple[dict[str, Frames], list[str]]:
    """Cameras by our names, all of one picture size, and notes on those left out.

    The size is that of the first agent's own camera, or else of the first camera.
    """
    cameras: dict[str, Frames] = {}
    notes = []
    for name in sorted(frames):
        camera = camera_from_release(name, agents)
        if camera in cameras:
            notes.append(f"camera {name} was left out: {cameras[camera].name} is camera {camera} already")
        else:
            cameras[camera] = frames[name]
    if cameras:
        size = cameras.get("agent1", next(iter(cameras.values()))).size_px
        for camera in [camera for camera, camera_frames in cameras.items() if camera_frames.size_px != size]:
            dropped = cameras.pop(camera)
            notes.append(
                f"camera {dropped.name} was left out: its pictures are {dropped.size_px} px, others {size}"
            )
    return {camera: cameras[camera] for camera in sort_cameras(cameras, agents)}, notes


class ReplayBufferSource(Source):
    """Source of demonstrations kept as arrays over all rows."""

    def __init__(
        self,
        path: Path,
        form: str,
        task: str,
        commands: NDArray[np.float32],
        ends: NDArray[np.integer],
        frames: Mapping[str, Frames],
        state: NDArray[np.float32] | None = None,
        notes: Sequence[str] = (),
        close: Callable[[], object] = lambda: None,
    ) -> None:
        """`commands` (T, N, 8); `state`: measured joints (T, N, 9); `ends` (E,): row after an episode.

        Raises StageError for arrays of different lengths, and for ends that do not rise.
        """
        agents = commands.shape[1]
        arms_text = f"it has commands of {agents} arms; expected 1 to {MOST_AGENTS}"
        require(0 < agents <= MOST_AGENTS, path, arms_text)
        require(len(ends) > 0, path, "episode_ends is empty")
        is_rising = bool((np.diff(ends.astype(np.int64), prepend=0) > 0).all())
        require(is_rising, path, f"episode_ends does not rise from above 0: {ends[:8].tolist()}")
        count, steps = len(commands), int(ends[-1])
        require(steps <= count, path, f"episode_ends names {steps} rows; there are commands of {count}")
        self._frames, left_out = select_cameras(frames, agents)
        for camera_frames in self._frames.values():
            rows_text = f"{camera_frames.name} has {camera_frames.shape[0]} rows, the commands {count}"
            require(camera_frames.shape[0] == count, path, f"{rows_text}; which of them lack is unknown")
        surplus_note = (
            [f"{count - steps} rows behind the last episode were left out"] if count > steps else []
        )
        self._ends = ends.astype(np.int64).tolist()
        self._starts = [0, *self._ends[:-1]]
        self._commands, self._state, self._close = commands, state, close
        episodes = [commands[start:end] for start, end in zip(self._starts, self._ends, strict=True)]
        seeds = [*range(len(episodes))]
        self.contents = Contents(
            form=form,
            task=task,
            agents=agents,
            episodes=[f"episode {seed}" for seed in seeds],
            seeds=seeds,
            steps=[len(episode) for episode in episodes],
            cameras=tuple(self._frames),
            size_px=next((camera_frames.size_px for camera_frames in self._frames.values()), (0, 0)),
            commands_digest=digest_commands(episodes, seeds),
            disturbed=within_limits(commands[:steps])[1] > 0,
            missing=[*MISSING, *["pictures"] * (not self._frames), *["measured joints"] * (state is None)],
            notes=[*notes, *left_out, *surplus_note, *bounds_note(episodes)],
        )

    def episode(self, index: int) -> Episode:
        start, end = self._starts[index], self._ends[index]
        commands = self._commands[start:end]
        qpos = assumed_qpos(commands) if self._state is None else self._state[start:end]
        subgoal, texts = counted_subgoals(commands)
        action, executed = action_and_executed(commands, None, self.contents.disturbed)
        return Episode(
            task=self.contents.task,
            seed=self.contents.seeds[index],
            qpos=qpos,
            qvel=np.zeros_like(qpos),
            action=action,
            executed=executed,
            images={camera: camera_frames.rows(start, end) for camera, camera_frames in self._frames.items()},
            subgoal=subgoal,
            certificate={"imported": self.contents.episodes[index], "subgoals": texts},
        )

    def close(self) -> None:
        self._close()
