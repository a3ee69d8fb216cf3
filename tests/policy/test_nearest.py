"""The lookup policy of examples/ replays the demonstration with the nearest start, and ignores the rest."""

from pathlib import Path

import numpy as np

from examples.foreign.nearest import make
from rf_exp.store import Store
from tests.policy.conftest import write_store


def test_the_demonstration_with_the_nearest_start_is_played_back(tmp_path: Path) -> None:
    path = write_store(tmp_path / "reach.zarr", 2, 4)
    store, policy = Store.open(path), make(str(path), 4)
    first = np.concatenate([[0], store.episode_ends[:-1]])
    for index, row in enumerate(first):
        seen = {f"pose_{name}": rows[row] + np.float32(1e-4) for name, rows in store.poses.items()}
        policy.reset(index)
        actions = policy.act(seen)
        np.testing.assert_array_equal(actions, store.by_episode(store.executed)[index])
        np.testing.assert_array_equal(policy.act(seen), actions[-1:])
