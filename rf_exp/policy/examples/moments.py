"""Which moments of demonstrations policies learn from, and what an agent means in them."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.inputs.coordination import hesitates, sent_on
from rf_exp.types import ARM_JOINTS

if TYPE_CHECKING:
    from rf_exp.store import Store

STILL_M = 5e-4  # less in a control step is no motion of a finger


def shown(store: "Store") -> NDArray[np.bool_]:
    """(T,) the steps that show what to do: those of the expert, where somebody else led to where it began."""
    said = np.asarray((store.subgoal >= 0).all(axis=1))
    return said if said.any() else ~said  # an older store does not say


def moving(store: "Store") -> NDArray[np.bool_]:
    """(T,) the steps in which somebody moves or means to: an arm is sent on, or fingers open or close."""
    kept = []
    for qpos, action, executed in by_episode(store):
        sent = (sent_on(qpos, action) | hesitates(action, executed)).any(axis=1)
        told = (np.diff(action[..., ARM_JOINTS], axis=0, prepend=1.0) != 0).any(axis=1)
        fingers = np.diff(
            qpos[..., ARM_JOINTS:].sum(axis=-1), axis=0, append=qpos[-1:, :, ARM_JOINTS:].sum(axis=-1)
        )
        kept.append(sent | told | (np.abs(fingers).max(axis=1) > STILL_M))
        kept[-1][-1] = True  # an episode keeps its end
    return np.concatenate(kept)


def by_episode(store: "Store") -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """Measured joints, intended and executed commands of each episode."""
    arrays = store.qpos, store.action, store.executed
    return zip(*(store.by_episode(each) for each in arrays), strict=True)


class Going:
    """The steps of an agent in which it does not hesitate."""

    def __init__(self, hesitates: NDArray[np.bool_]) -> None:
        self._steps = np.flatnonzero(~hesitates)
        self._next = np.searchsorted(self._steps, np.arange(len(hesitates)))  # for each step, that or a later

    def rows(
        self, ahead: NDArray[np.int64], first: NDArray[np.int64], last: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """(B, T) consecutive steps from `ahead[:, 0]` on, in episodes from `first` (B, 1) to `last`."""
        start = np.clip(ahead[:, :1], first, last)
        at = self._next[start] + ahead - start
        return self._steps[np.clip(at, self._next[first], self._next[last])]
