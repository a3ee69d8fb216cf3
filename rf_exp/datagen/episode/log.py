"""What is kept of every control step while an episode is made, and the episode that becomes of it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Task
from rf_exp.transforms import Matrix, quaternion
from rf_exp.types import UNITS, Episode, Judged, Measured, Scene, Verdict


class Frame(NamedTuple):
    """One control step: what was seen, what was intended then, what was done, and what for."""

    scene: Scene
    action: NDArray[np.float64]  # (N, A)
    executed: NDArray[np.float64]  # (N, A)
    images: Mapping[str, NDArray[np.uint8]]
    subgoal: NDArray[np.int16]  # (N,)
    extras: Mapping[str, NDArray]


class EpisodeLog:
    """The control steps of one episode, and its rounds of planning."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.rounds: list[dict[str, object]] = []  # proposals with their checks, and violations, as JSON
        self._verdicts: list[Verdict] = []  # on what each frame has led to

    def judged(self, verdict: Verdict) -> None:
        """What the last frame has led to."""
        self._verdicts.append(verdict)

    def episode(
        self, task: Task, seed: int, cameras: Sequence[str], subgoals: list[list[str]], disturbed: bool
    ) -> Episode:
        """All of it as a demonstration; `subgoals` are the texts of each agent's numbers."""
        scenes, intended, executed, images, numbers, extras = zip(*self.frames, strict=True)
        certificate = {
            "rounds": self.rounds,
            "evidence": dict(self._verdicts[-1].evidence),
            "subgoals": subgoals,
        }
        return Episode(
            task.name,
            seed,
            np.stack([scene.qpos for scene in scenes]).astype(np.float32),
            np.stack([scene.qvel for scene in scenes]).astype(np.float32),
            np.stack(intended).astype(np.float32),
            {name: np.stack([frame[name] for frame in images]) for name in cameras},
            certificate,
            np.stack(executed).astype(np.float32) if disturbed else None,
            {name: _poses(np.stack([scene.poses[name] for scene in scenes])) for name in task.objects},
            np.stack(numbers),
            _judged(self._verdicts),
            {name: np.stack([taken[name] for taken in extras]) for name in extras[0]},
        )


def _poses(world_from_object: Matrix) -> NDArray[np.float32]:
    """(T, 4, 4) -> (T, dof) position in m and quaternion w, x, y, z."""
    parts = [world_from_object[:, :3, 3], quaternion(world_from_object)]
    return np.concatenate(parts, axis=1).astype(np.float32)


def _judged(verdicts: Sequence[Verdict]) -> Judged:
    """How far each condition was met, step by step."""
    names = tuple(verdicts[0].evidence)
    found = [
        [verdict.measured.get(name) or _yes_or_no(verdict.evidence[name]) for name in names]
        for verdict in verdicts
    ]
    return Judged(
        names,
        np.array([[each.value for each in row] for row in found], np.float32),
        np.array([[each.bound for each in row] for row in found], np.float32),
        np.array([[UNITS.index(each.unit) for each in row] for row in found], np.uint8),
        np.array([[each.holds for each in row] for row in found], np.bool_),
    )


def _yes_or_no(holds: bool) -> Measured:
    return Measured(holds, float(holds), 1.0, "", True)
