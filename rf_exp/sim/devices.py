"""Inexact sensors and actuators between the simulator and the policies."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Start
from rf_exp.types import CONTROL_DT_S, FLICKER, PIXELS, Scene, joints_of

FLICKER_RANGE = 0.1  # half range of a flickering frame's relative exposure (RoboTwin 2.0)


class Devices:
    """Cameras, joint encoders and drives of one episode."""

    def __init__(self, start: Start, command: NDArray[np.float64], cameras: Sequence[str]) -> None:
        """`command` (N, A) holds the arms at their initial true joints; `cameras` in the task's order."""
        self._config, self._seed = start.devices, start.seed
        self._copy = [start.copy] if start.copy else []
        self._offset = np.array(self._config.joint_offset_rad) if self._config.joint_offset_rad else 0.0
        self._command_queue = deque([command.copy() for _ in range(self._config.delay_steps)])
        self._impaired, self._dark_camera = self._config.impaired, -1
        if self._impaired is not None:
            self._row = self._impaired.agent - 1
            self._impaired_target = command[self._row].copy()  # last target of the impaired arm
            self._impaired_queue = deque([self._impaired_target] * self._impaired.delay_steps)
            if self._impaired.dark:
                self._dark_camera = cameras.index(f"agent{self._impaired.agent}")

    def delayed_target(self, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """Delayed targets (N, A), in true joints, for the step in which (N, A) is commanded."""
        if self._config.exact:
            return command
        target = command.copy()
        target[:, :-1] -= self._offset
        self._command_queue.append(target)
        delayed = self._command_queue.popleft()
        if self._impaired is not None:
            self._impaired_queue.append(delayed[self._row].copy())
            delayed[self._row] = self._limit_speed(self._impaired_queue.popleft(), self._impaired.speed_rad_s)
        return delayed

    def _limit_speed(self, target: NDArray[np.float64], speed_rad_s: float) -> NDArray[np.float64]:
        """Limits a target (A,) of the impaired arm to its joint speed."""
        if speed_rad_s:
            limit_rad = speed_rad_s * CONTROL_DT_S
            target[:-1] = self._impaired_target[:-1] + (target - self._impaired_target)[:-1].clip(
                -limit_rad, limit_rad
            )
        self._impaired_target = target
        return target

    def holding_command(self, true: NDArray[np.float64]) -> NDArray[np.float64]:
        """The command (N, A), in measured joints, that holds arms at their true joints."""
        command = true.copy()
        command[:, :-1] += self._offset
        return command

    def true_joints(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """True joints (N, D) from measured ones."""
        true_qpos = qpos.copy()
        joints_of(true_qpos)[:] -= self._offset
        return true_qpos

    def measured_scene(self, scene: Scene) -> Scene:
        """The scene with measured joints in place of true ones."""
        if not self._config.joint_offset_rad:
            return scene
        qpos = scene.qpos.copy()
        joints_of(qpos)[:] += self._offset
        return replace(scene, qpos=qpos, joint_offset_rad=self._offset)

    def degraded_picture(self, picture: NDArray[np.uint8], camera: int, step: int) -> NDArray[np.uint8]:
        """A rendered picture (H, W, 3) with the errors of this camera at a control step; deterministic."""
        if self._config.exact_pictures:
            return picture
        if camera == self._dark_camera:
            return np.zeros_like(picture)
        gain = self._config.gain
        # The lamp flickers: the same random numbers for all cameras.
        rng = np.random.default_rng([self._seed, FLICKER, step, *self._copy])
        if rng.uniform() < self._config.flicker:
            gain *= 1.0 + rng.uniform(-FLICKER_RANGE, FLICKER_RANGE)
        degraded = np.multiply(picture, np.float32(gain), dtype=np.float32)
        if self._config.pixel_noise:
            noise = np.random.default_rng([self._seed, PIXELS, step, camera, *self._copy])
            added = noise.standard_normal(picture.shape, np.float32)
            added *= np.float32(self._config.pixel_noise)
            degraded += added
        return np.rint(degraded, out=degraded).clip(0, 255, out=degraded).astype(np.uint8)
