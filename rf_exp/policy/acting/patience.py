"""How long an arm waits in a scene in which nothing changes.

Whether an arm may go on is learned from single moments. Where those before it leaves look like those in
which it has to stay (a shutter that has been pressed looks as it did, an arm that comes late stands where it
stood), what is learned is the rate of leaving: a number below a half, the same at every look. Who waits for
more than a half waits for ever. How likely it should have left by now is what the looks add up to.
"""

import numpy as np
from numpy.typing import NDArray

SAME = 0.03  # predictions that differ by less are of a scene in which nothing changes


class Patience:
    """Of some agents through one episode. With a `bound` of 0 every look stands for itself."""

    def __init__(self, bound: float) -> None:
        self._bound = bound
        self._last: NDArray[np.float64] | None = None  # (n, K + 1), of the last look
        self._sums: NDArray[np.float64] = np.zeros(0)  # (n, K + 1), of the looks since something changed

    def __call__(self, chances: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Numbers of the subgoals (n,) and who may go on (n,), by the chances (n, K + 1) that a look gives.

        Who goes on because its chances add up to the bound is at a later subgoal than the most likely one, if
        at least half of them say so.
        """
        if self._last is None:
            self._last, self._sums = chances, np.zeros_like(chances)
        changes = np.abs(chances - self._last).max(axis=1) > SAME
        self._sums[changes] = 0
        self._sums += chances
        self._last = chances
        numbers, free = chances[:, :-1].argmax(axis=1), chances[:, -1] > 0.5
        if not self._bound:
            return numbers, free
        reached = ~free & (self._sums[:, -1] >= self._bound)
        for agent in np.flatnonzero(reached):
            *subgoals, leaves = self._sums[agent]
            likely = np.flatnonzero(np.array(subgoals) >= leaves / 2)
            numbers[agent] = max(numbers[agent], *likely)
        return numbers, free | reached
