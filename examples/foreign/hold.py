"""Minimal foreign policy: every arm holds its posture. For `foreign.factory`: docs/foreign.md.

python -m rf_exp.run stages=[evaluate,report] foreign.name=hold foreign.factory=examples.foreign.hold:make
"""

import numpy as np
from numpy.typing import NDArray


class Hold:
    """Policy that repeats the observed joints, with open grippers."""

    def __init__(self, steps: int) -> None:
        self._steps = steps

    def reset(self, seed: int) -> None:
        """Called at the start of an episode; only policies with a state need it."""

    def act(self, observation: dict) -> NDArray[np.float32]:
        """A chunk (T, N, 8) float32: seven joint targets in rad and the gripper in [-1, 1] per agent."""
        joints = observation["qpos"][:, :7]
        targets = np.column_stack([joints, np.ones(len(joints), np.float32)])
        return np.tile(targets, (self._steps, 1, 1))


def make(steps: int = 20) -> Hold:
    """Factory; `foreign.options` are its keyword arguments."""
    return Hold(steps)
