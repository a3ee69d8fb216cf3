"""Inexact sensors and actuators between the simulator and the policies."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Start
from rf_exp.types import CONTROL_DT_S, FLICKER, PIXELS, Scene, joints_of

FLICKERS = 0.1  # half range of a flickering frame's relative exposure (RoboTwin 2.0)


class Devices:
    """Cameras, joint encoders and drives of one episode."""

    def __init__(self, start: Start, command: NDArray[np.float64], cameras: Sequence[str]) -> None:
        """`command` (N, A) holds the arms at their initial true joints; `cameras` in the task's order."""
        self._how, self._seed = start.devices, start.seed
        self._copy = [start.copy] if start.copy else []
        self._offset = np.array(self._how.joint_offset_rad) if self._how.joint_offset_rad else 0.0
        self._late = deque([command.copy() for _ in range(self._how.delay_steps)])
        self._impaired, self._dark = self._how.impaired, -1
        if self._impaired is not None:
            self._row = self._impaired.agent - 1
            self._follows = command[self._row].copy()  # last target of the impaired arm
            self._waits = deque([self._follows] * self._impaired.delay_steps)
            if self._impaired.dark:
                self._dark = cameras.index(f"agent{self._impaired.agent}")

    def carried_out(self, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """Delayed targets (N, A), in true joints, for the step in which (N, A) is commanded."""
        if self._how.exact:
            return command
        meant = command.copy()
        meant[:, :-1] -= self._offset
        self._late.append(meant)
        told = self._late.popleft()
        if self._impaired is not None:
            self._waits.append(told[self._row].copy())
            told[self._row] = self._follow(self._waits.popleft(), self._impaired.speed_rad_s)
        return told

    def _follow(self, told: NDArray[np.float64], speed_rad_s: float) -> NDArray[np.float64]:
        """Limits a target (A,) of the impaired arm to its joint speed."""
        if speed_rad_s:
            most = speed_rad_s * CONTROL_DT_S
            told[:-1] = self._follows[:-1] + (told - self._follows)[:-1].clip(-most, most)
        self._follows = told
        return told

    def command_of(self, true: NDArray[np.float64]) -> NDArray[np.float64]:
        """The command (N, A), in measured joints, that holds arms at their true joints."""
        said = true.copy()
        said[:, :-1] += self._offset
        return said

    def true(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """True joints (N, D) from measured ones."""
        found = qpos.copy()
        joints_of(found)[:] -= self._offset
        return found

    def measured(self, scene: Scene) -> Scene:
        """The scene with measured joints in place of true ones."""
        if not self._how.joint_offset_rad:
            return scene
        qpos = scene.qpos.copy()
        joints_of(qpos)[:] += self._offset
        return replace(scene, qpos=qpos, joint_offset_rad=self._offset)

    def taken(self, picture: NDArray[np.uint8], camera: int, step: int) -> NDArray[np.uint8]:
        """A rendered picture (H, W, 3) with the errors of this camera at a control step; deterministic."""
        if self._how.sees_exactly:
            return picture
        if camera == self._dark:
            return np.zeros_like(picture)
        gain = self._how.gain
        # The lamp flickers: the same random numbers for all cameras.
        rng = np.random.default_rng([self._seed, FLICKER, step, *self._copy])
        if rng.uniform() < self._how.flicker:
            gain *= 1.0 + rng.uniform(-FLICKERS, FLICKERS)
        seen = np.multiply(picture, np.float32(gain), dtype=np.float32)
        if self._how.pixel_noise:
            noise = np.random.default_rng([self._seed, PIXELS, step, camera, *self._copy])
            added = noise.standard_normal(picture.shape, np.float32)
            added *= np.float32(self._how.pixel_noise)
            seen += added
        return np.rint(seen, out=seen).clip(0, 255, out=seen).astype(np.uint8)
