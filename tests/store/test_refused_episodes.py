"""Episodes that do not match a store are refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rf_exp.errors import StageError
from rf_exp.store import Store
from tests.store.episodes import make_episode, make_store


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"executed": None}, "no executed actions of its own"),
        ({"poses": {}}, r"poses of \[\]; .* \['barrier'\]"),
    ],
)
def test_an_episode_with_other_arrays_is_refused(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store, pytest.raises(StageError, match=message):
        store.append(replace(make_episode(1), **change))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": "take_photo"}, r"of seed 5 is of task 'take_photo'; .* holds 'lift_barrier'"),
        ({"seed": 0}, "of seed 0 is stored already"),
        ({"images": {}}, r"has images of \[\]; .* expects \['agent1', 'agent2', 'global'\]"),
        (
            {"action": np.zeros((7, 2, 9), np.float32)},
            r"data/action of the episode of seed 5 is float32 \(7, 2, 9\); expected float32 \(7, 2, 8\)",
        ),
        ({"qvel": np.zeros((7, 2, 9))}, r"data/qvel .* is float64 \(7, 2, 9\); expected float32"),
        ({"qpos": np.full((7, 2, 9), np.nan, np.float32)}, "data/qpos .* holds values that are not finite"),
        ({"qpos": np.zeros((0, 2, 9), np.float32)}, "has no steps; expected at least one"),
    ],
)
def test_an_episode_that_does_not_match_is_refused(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store, pytest.raises(StageError, match=message):
        store.append(replace(make_episode(5), **change))  # pyright: ignore[reportArgumentType]
    assert len(Store.open(path)) == 1


def test_a_reader_cannot_append(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [])
    with pytest.raises(StageError, match="open for reading; open it with writable=True to append"):
        Store.open(path).append(make_episode(0))
