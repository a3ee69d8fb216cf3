"""Nearest-neighbour baseline: plays back the demonstration with the nearest initial state, in open loop.

Its success rate shows how hard a task is: it is given the true poses at the start, and uses nothing later.

    python -m rf_exp.run stages=[generate] task=lift_barrier demos=50 render=false
    python -m rf_exp.run stages=[evaluate,report] task=lift_barrier scenes=100 render=false \
        foreign.name=nearest foreign.factory=examples.foreign.nearest:make foreign.demos=50 \
        foreign.observations='{state: full, pictures: false}' \
        'foreign.options={store: outputs/data/lift_barrier/full/fast.zarr, demos: 50}'
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.store import Store

HEADING_M = 0.05  # distance that corresponds to a rotation of an object by one radian


class Nearest:
    """Policy that plays all actions of one demonstration and then holds the last one."""

    def __init__(self, store: str, demos: int) -> None:
        store_part = Store.open(store).first(demos)
        first = np.concatenate([[0], store_part.episode_ends[:-1]])
        self._names = store_part.objects
        self._starts = np.stack([place({n: store_part.poses[n][row] for n in self._names}) for row in first])
        self._actions = store_part.by_episode(store_part.executed)
        self._last: NDArray[np.float32] | None = None  # (1, N, 8), to be held after the demonstration

    def reset(self, seed: int) -> None:
        """Starts a new episode."""
        self._last = None

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """A chunk (T, N, 8): the whole demonstration at first, its last action afterwards."""
        if self._last is not None:
            return self._last
        features = place({name: observation[f"pose_{name}"] for name in self._names})
        demonstration = self._actions[int(np.linalg.norm(self._starts - features, axis=1).argmin())]
        self._last = demonstration[-1:]
        return demonstration


def place(poses: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float64]:
    """Features of all objects from their poses (7,): position in m, and heading as a point on a circle."""
    parts = []
    for pose in poses.values():
        w, x, y, z = pose[3:]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        parts += [pose[:3], HEADING_M * np.array([np.cos(yaw), np.sin(yaw)])]
    return np.concatenate(parts)


def make(store: str, demos: int) -> Nearest:
    """Factory for `foreign.factory`."""
    return Nearest(store, demos)
