"""What stands between the simulated world and who acts in it: sensors and actuators that are not exact."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import Start
from rf_exp.types import CONTROL_DT_S, FLICKER, PIXELS, Scene, joints_of

FLICKERS = 0.1  # half range of a flickering frame's relative exposure (RoboTwin 2.0)


class Devices:
    """The cameras, joint encoders and drives of one episode."""

    def __init__(self, start: Start, command: NDArray[np.float64], cameras: Sequence[str]) -> None:
        """`command` (N, A) is where the arms are held at first, by their true joints; `cameras` in order."""
        self._how, self._seed = start.devices, start.seed
        self._copy = [start.copy] if start.copy else []
        self._offset = np.array(self._how.joint_offset_rad) if self._how.joint_offset_rad else 0.0
        self._late = deque([command.copy() for _ in range(self._how.delay_steps)])
        self._impaired, self._dark = self._how.impaired, -1
        if self._impaired is not None:
            self._row = self._impaired.agent - 1
            self._follows = command[self._row].copy()  # what the impaired arm is at
            self._waits = deque([self._follows] * self._impaired.delay_steps)
            if self._impaired.dark:
                self._dark = cameras.index(f"agent{self._impaired.agent}")

    def carried_out(self, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the arms are told by their true joints in the step in which (N, A) is commanded."""
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
        """What the impaired arm does of what it is told (A,): no joint of it goes faster than it can."""
        if speed_rad_s:
            most = speed_rad_s * CONTROL_DT_S
            told[:-1] = self._follows[:-1] + (told - self._follows)[:-1].clip(-most, most)
        self._follows = told
        return told

    def command_of(self, true: NDArray[np.float64]) -> NDArray[np.float64]:
        """The command (N, A) that holds arms where their true joints are."""
        said = true.copy()
        said[:, :-1] += self._offset
        return said

    def true(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (N, D) as they are, of those that were measured."""
        found = qpos.copy()
        joints_of(found)[:] -= self._offset
        return found

    def measured(self, scene: Scene) -> Scene:
        """The scene with the joints as they are measured."""
        if not self._how.joint_offset_rad:
            return scene
        qpos = scene.qpos.copy()
        joints_of(qpos)[:] += self._offset
        return replace(scene, qpos=qpos, joint_offset_rad=self._offset)

    def taken(self, picture: NDArray[np.uint8], camera: int, step: int) -> NDArray[np.uint8]:
        """A picture (H, W, 3) as the camera of this number delivers it at a control step, each time alike."""
        if self._how.sees_exactly:
            return picture
        if camera == self._dark:
            return np.zeros_like(picture)
        gain = self._how.gain
        # Of all cameras: the lamp flickers.
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
