"""Scripted policies, and a world of arms that follow commands with a realistic lag."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from rf_exp.observations import Observation
from rf_exp.policy import PolicyRunner, Stream, View
from rf_exp.tasks import Task
from rf_exp.types import Scene
from tests.scenes import start_scene

FASTEST_RAD = 0.045  # per control step
TRACKING = 1 - np.exp(-0.5)  # part of the way to its command that an arm covers in a control step

Predict = Callable[[int, Observation], NDArray[np.float64]]  # number, observation -> targets (T, 8)


class Scripted(PolicyRunner):
    """Runner of one agent whose predictions a function gives."""

    def __init__(self, agent: int, predict: Predict) -> None:
        self._targets, self.predictions = predict, 0
        super().__init__(View(f"agent{agent}", (Stream(f"agent{agent}", (agent,)),)), np.array([FASTEST_RAD]))

    def reset(self, seed: int) -> None:
        super().reset(seed)
        self.predictions = 0

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        self.predictions += 1
        return self._targets(self.predictions - 1, observation)[:, None]


class Puppets:
    """World of arms alone, which follow their commands with the lag of the real ones, without collisions."""

    cameras = ()

    def __init__(self, task: Task, **changes) -> None:
        self._task, self._changes = task, changes

    def reset(self, seed: int) -> Scene:
        start = start_scene(self._task, seed)
        self._qpos, self._poses = start.qpos.copy(), start.poses
        self.commands: list[NDArray[np.float64]] = []
        return self._scene()

    def step(self, action: NDArray[np.float64]) -> Scene:
        self.commands.append(action)
        self._qpos[:, :7] += TRACKING * (action[:, :7] - self._qpos[:, :7])
        return self._scene()

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        return {}

    def _scene(self) -> Scene:
        values = {
            "qpos": self._qpos.copy(),
            "qvel": np.zeros_like(self._qpos),
            "poses": self._poses,
            "speeds": dict.fromkeys(self._poses, 0.0),
            "held": (None,) * len(self._qpos),
        }
        return Scene(len(self.commands), **{**values, **self._changes})
