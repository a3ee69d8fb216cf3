"""What the agents of a runner are told next: predicted targets, approached at the demonstrations' speed."""

from collections import deque
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import ARM_JOINTS


class Targets:
    """A queue of predicted targets for each agent of a runner, in the order of its view.

    A target further away than the demonstrations ever moved in a control step is approached by linear
    interpolation in joint space. An agent that was kept from its target has it still before it, so agents
    may have different numbers of them.
    """

    def __init__(self, fastest_rad: NDArray[np.float64]) -> None:
        self._fastest_rad = fastest_rad  # (agents,) a control step
        self._queues = [deque[NDArray[np.float64]]() for _ in fastest_rad]  # of (8,)
        self._last: NDArray[np.float64] | None = None  # (agents, 7) arm targets given last

    def __len__(self) -> int:
        """The targets left for the agent that has the fewest."""
        return min(map(len, self._queues))

    @property
    def last(self) -> NDArray[np.float64]:
        """(agents, 7) the arm targets given last, or where motion begins."""
        assert self._last is not None
        return self._last

    def start(self, qpos: NDArray[np.float64]) -> None:
        """Measured joints (agents, 9), where motion begins; nothing once it has begun."""
        if self._last is None:
            self._last = qpos[:, :ARM_JOINTS]

    def put(self, chunk: NDArray[np.float64]) -> None:
        """Targets (T, agents, 8) from now on, instead of what was left."""
        self._queues = [deque(chunk[:, row]) for row in range(chunk.shape[1])]

    def forget(self, row: int) -> None:
        """Drop what is left for one agent, so that a prediction is due."""
        self._queues[row].clear()

    def ahead(self, steps: int | None = None) -> list[NDArray[np.float64]]:
        """The commands (T, 8) of each agent from this control step on, as they will be given."""
        assert self._last is not None  # motion has begun
        found = []
        for queue, last, fastest in zip(self._queues, self._last, self._fastest_rad, strict=True):
            rows = []
            for target in list(queue)[:steps]:
                change = target[:ARM_JOINTS] - last
                part = fastest / np.maximum(np.abs(change).max(), fastest + 1e-12)  # at most 1
                last = last + part * change
                rows.append(np.append(last, np.clip(target[ARM_JOINTS], -1.0, 1.0)))
            found.append(np.array(rows))
        return found

    def given(self, commands: NDArray[np.float64], kept: Collection[int] = ()) -> None:
        """What was commanded, (agents, 8); the rows in `kept` were kept from their targets."""
        self._last = commands[:, :ARM_JOINTS].copy()
        for row, queue in enumerate(self._queues):
            if row not in kept:
                queue.popleft()
