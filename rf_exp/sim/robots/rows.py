"""The joints of a robot in SAPIEN's order, as rows of the suite and back."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import Robot
from rf_exp.types import FINGERS

Floats = NDArray[np.float64]


class Rows:
    """Of one robot whose active joints have these names; rows of measured joints are as long as `size` says.

    Raises ArgumentError for joints that are neither of the arm nor of a finger, and for fingers without one.
    """

    def __init__(self, robot: Robot, names: Sequence[str], size: int) -> None:
        self._robot, self._size = robot, size
        fingers = robot.hand.fingers
        ours = robot.active
        if set(names) != set(ours) or not all(finger.joints for finger in fingers):
            raise ArgumentError(
                f"robot {robot.name!r} has the joints {', '.join(names)} in simulation; expected those of "
                f"its arm and of two fingers: {', '.join(ours)}"
            )
        self._measured = [names.index(joint) for joint in robot.measured]
        self._closed = np.array([finger.closed for finger in fingers])
        self._per_m = np.array([finger.per_m for finger in fingers])
        columns = {joint: column for column, joint in enumerate(robot.joints)}
        columns |= {joint: k - FINGERS for k, finger in enumerate(fingers) for joint in finger.joints}
        self._told = [columns[name] for name in names]

    def qpos(self, values: NDArray[np.floating]) -> Floats:
        """(D,) rad and metres, of all active joints."""
        row = self._row(values)
        row[-FINGERS:] = (row[-FINGERS:] - self._closed) / self._per_m
        return row

    def qvel(self, values: NDArray[np.floating]) -> Floats:
        """(D,) rad/s and m/s, of all active joints."""
        row = self._row(values)
        row[-FINGERS:] /= self._per_m
        return row

    def active(self, row: Floats) -> Floats:
        """All active joints, of a row of the arm's joints and the fingers (D,)."""
        whole = row.copy()
        whole[-FINGERS:] = self._closed + self._per_m * row[-FINGERS:]
        return whole[self._told]

    def targets(self, command: Floats) -> Floats:
        """Where all active joints are sent to by a command (D - 1,)."""
        finger_m = self._robot.hand.told_m(command[-1])
        return self.active(np.concatenate([command[:-1], [finger_m, finger_m]]))

    def _row(self, values: NDArray[np.floating]) -> Floats:
        row, dof = np.zeros(self._size), self._robot.dof
        found = values[self._measured]
        row[:dof], row[-FINGERS:] = found[:dof], found[dof:]
        return row
