"""What the grippers of an episode have done so far, and what of that counts.

Fingers that have shut on nothing and open again have changed nothing: such a miss is taken back, so that what
comes next is once more what came next before it.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

CHANGES = 6  # of a gripper that are told apart
RECENT_STEPS = 20  # since the last of them: what is longer ago is all the same
MEMORY = CHANGES + 2
EMPTY_M = 0.004  # fingers that have shut on nothing are nearer to each other


class Memory:
    """What the grippers have been told so far: how often they changed, as one-hot, and how recently.

    A picture after the fingers closed looks much like the one before, and what comes next is not the same.
    """

    def __init__(self, agents: int) -> None:
        self._open = np.ones(agents, dtype=bool)  # as every episode begins
        self._changes = np.zeros(agents, dtype=int)
        self._since = np.full(agents, RECENT_STEPS)

    def told(self, grippers: Mapping[int, float], widths: NDArray[np.floating]) -> None:
        """The commands of one control step, of those agents whose commands are known.

        `widths` (N,) is how far apart the fingers of each were measured before it, in m.
        """
        opened = self._open.copy()
        for agent, command in grippers.items():
            opened[agent - 1] = command > 0
        changed = opened != self._open
        self._open = opened
        self._changes = self._changes + np.where(opened & (widths < EMPTY_M), -1, 1) * changed
        self._since = np.where(changed, 0, np.minimum(self._since + 1, RECENT_STEPS))

    @property
    def changes(self) -> NDArray[np.int64]:
        """(N,) how often the gripper of each agent has changed."""
        return self._changes

    @property
    def opened(self) -> NDArray[np.bool_]:
        """(N,) whether the gripper of each agent was last told to open."""
        return self._open

    @property
    def vector(self) -> NDArray[np.float64]:
        """(N, MEMORY)."""
        count = np.eye(CHANGES + 1)[np.minimum(self._changes, CHANGES)]
        return np.column_stack([count, self._since / RECENT_STEPS])


def remembered(grippers: NDArray[np.floating], widths: NDArray[np.floating]) -> NDArray[np.float32]:
    """The memory (T, N, MEMORY) before each step of an episode with commands and widths in m, (T, N) each."""
    memory, rows = Memory(grippers.shape[1]), []
    for commands, apart in zip(grippers, widths, strict=True):
        rows.append(memory.vector)
        memory.told(dict(enumerate(commands, start=1)), apart)
    return np.array(rows, np.float32)


def changes(gripper: NDArray[np.floating], width: NDArray[np.floating]) -> NDArray[np.int64]:
    """The steps of an episode in which a gripper changes, from its commands and widths in m, (T,) each.

    Without those that are taken back.
    """
    found: list[int] = []
    for step in np.flatnonzero(np.diff(gripper > 0, prepend=True)):
        if gripper[step] > 0 and width[step] < EMPTY_M and found:
            found.pop()
        else:
            found.append(int(step))
    return np.array(found, np.int64)
