"""The smallest policy of another: every arm stays where it is. For `foreign.factory`: docs/foreign.md.

python -m rf_exp.run stages=[evaluate,report] foreign.name=hold foreign.factory=examples.foreign.hold:make
"""

import numpy as np
from numpy.typing import NDArray


class Hold:
    """Chunks of the joints that it sees, with the grippers open."""

    def __init__(self, steps: int) -> None:
        self._steps = steps

    def reset(self, seed: int) -> None:
        """An episode begins, in the scene of a seed. Only who remembers something needs this."""

    def act(self, observation: dict) -> NDArray[np.float32]:
        """(T, N, 8) float32: seven joint targets in rad and the gripper in [-1, 1] of each of N agents."""
        joints = observation["qpos"][:, :7]
        targets = np.column_stack([joints, np.ones(len(joints), np.float32)])
        return np.tile(targets, (self._steps, 1, 1))


def make(steps: int = 20) -> Hold:
    """What `foreign.options` says comes as keyword arguments."""
    return Hold(steps)
