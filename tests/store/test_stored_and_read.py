"""The store returns episodes as they were written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_exp.artifacts import commit
from rf_exp.store import Store
from tests.store.episodes import (
    AGENTS,
    CAMERAS,
    HEIGHT,
    IDENTITY,
    OBJECTS,
    WIDTH,
    assert_same,
    make_episode,
    make_store,
)


def test_a_store_without_poses_and_subgoals_is_read(tmp_path: Path) -> None:
    episode = replace(make_episode(0), executed=None, poses={}, subgoal=None)
    with Store.create(tmp_path / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH) as store:
        store.append(episode)
        assert (store.subgoal == -1).all() and store.executed is store.action
    unknown = np.full((7, AGENTS), -1, np.int16)
    assert_same(Store.open(tmp_path / "s.zarr", IDENTITY).episode(0), replace(episode, subgoal=unknown))


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=5),
    cameras=st.sampled_from([(), ("global",), CAMERAS]),
    reopen=st.booleans(),
)
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], cameras: tuple[str, ...], reopen: bool
) -> None:
    episodes = [make_episode(seed, steps, cameras) for seed, steps in enumerate(lengths)]
    path = tmp_path_factory.mktemp("store") / "demos.zarr"
    make_store(path, [] if reopen else episodes, cameras)
    if reopen:
        for episode in episodes:
            with Store.open(path, IDENTITY, writable=True) as store:
                store.append(episode)
    store = Store.open(path, IDENTITY)
    assert (len(store), store.steps, store.agents, store.cameras) == (
        len(lengths),
        sum(lengths),
        AGENTS,
        cameras,
    )
    assert store.episode_ends.tolist() == np.cumsum(lengths).tolist()
    assert store.seeds.tolist() == list(range(len(lengths)))
    assert store.certificates == [dict(episode.certificate) for episode in episodes]
    np.testing.assert_array_equal(store.action, np.concatenate([e.action for e in episodes]))
    for camera in cameras:
        pictures = np.concatenate([episode.images[camera] for episode in episodes])
        np.testing.assert_array_equal(store.images[camera][:], pictures)
    for index, episode in enumerate(episodes):
        assert_same(store.episode(index), episode)
    assert_same(store.episode(-1), episodes[-1])
    with pytest.raises(IndexError, match=rf"episode {len(lengths)} of {len(lengths)}"):
        store.episode(len(lengths))


def test_episodes_longer_than_a_file(tmp_path: Path) -> None:
    episodes = [make_episode(0, 300, ("global",)), make_episode(1, 300, ("global",))]
    store = Store.open(make_store(tmp_path / "long.zarr", episodes, ("global",)))
    assert_same(store.episode(1), episodes[1])
    assert len(list((tmp_path / "long.zarr/data/rgb_global").rglob("c/*/0/0/0"))) == 3  # 256 frames each


def test_a_writer_reads_what_it_wrote(tmp_path: Path) -> None:
    with Store.create(tmp_path / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH, OBJECTS, True) as store:
        for seed in range(3):
            store.append(make_episode(seed))
            assert_same(store.episode(seed), make_episode(seed))
            assert len(store.qpos) == 7 * (seed + 1)


def test_attributes_hold_the_provenance(tmp_path: Path) -> None:
    attrs = Store.open(make_store(tmp_path / "s.zarr", [])).attrs
    assert attrs["task"] == "lift_barrier"
    assert attrs["criteria_version"] == "1"
    assert (attrs["generator"], attrs["commit"]) == ("1.1", commit())
    assert attrs["control_hz"] == 20
    assert attrs["identity"]["ranges"] == {"x_m": [-0.1, 0.1]}
    assert {"python", "numpy", "zarr"} <= set(attrs["versions"])


@pytest.mark.slow
def test_the_digest_depends_on_the_content_only(tmp_path: Path) -> None:
    episodes = [make_episode(seed) for seed in range(3)]
    digest = Store.open(make_store(tmp_path / "a.zarr", episodes)).digest()
    assert digest == Store.open(make_store(tmp_path / "b.zarr", episodes)).digest()
    frames = {**episodes[2].images, "agent2": episodes[2].images["agent2"] ^ 1}
    changed = [*episodes[:2], replace(episodes[2], images=frames)]
    assert digest != Store.open(make_store(tmp_path / "c.zarr", changed)).digest()
    assert digest != Store.open(make_store(tmp_path / "d.zarr", episodes[::-1])).digest()
