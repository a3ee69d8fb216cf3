"""A flipped byte in a file of a store: the number of episodes that are lost."""

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from rf_exp.store import Damage, DamagedStore, Store, merge
from rf_exp.types import Episode
from tests.store.episodes import AGENTS, IDENTITY, OBJECTS, assert_same
from tests.test_data import DESCRIPTION, full_episode
from tests.test_rescue import digest, flip

SEEDS, STEPS = range(3, 13), 95  # length of demonstrations of Lift Barrier
STATES_ONLY = replace(DESCRIPTION, camera_models={}, depth=False, labels=())
COSTS = {  # most episodes, of 10, that one byte may cost
    "data/qpos": 3, "data/time_s": 0, "meta/certificate": 1, "meta/seed": 0, "meta/episode_ends": 0
}  # fmt: skip


def episode(seed: int) -> Episode:
    """The states of an episode, with a unique certificate that holds the row of its attempt."""
    full = full_episode(seed, STEPS)
    certificate = {**full.certificate, "row": {"seed": seed}, "checks": full.qpos[:20].tolist()}
    return replace(full, images={}, extras={}, certificate=certificate)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "s.zarr"
    with Store.create(path, IDENTITY, AGENTS, (), 0, 0, OBJECTS, True, STATES_ONLY) as store:
        for seed in SEEDS:
            store.append(episode(seed))
    return path


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return shutil.copytree(original, tmp_path / "s.zarr")


def readable_seeds(path: Path) -> list[int]:
    """The seeds of the episodes that a damaged store still returns, each compared with the stored one."""
    seeds = []
    with TemporaryDirectory() as frame:
        damaged = DamagedStore(path, Path(frame))
        for index in range(len(damaged.ends)):
            with suppress(Damage):
                read = damaged.episode(index)
                assert_same(read, episode(read.seed))
                seeds.append(read.seed)
    return seeds


@pytest.mark.slow
def test_a_flipped_byte_loses_only_the_episodes_of_its_chunk(path: Path) -> None:
    for name, cost in COSTS.items():
        file = min(each for each in (path / name / "c").rglob("*") if each.is_file())
        content = file.read_bytes()
        flip(file)
        before = digest(path)
        assert len(SEEDS) - len(readable_seeds(path)) <= cost, name
        assert digest(path) == before, f"{name}: the damaged store is touched"
        with pytest.raises(Damage):
            assert Store.open(path).certificates
        file.write_bytes(content)
    assert readable_seeds(path) == [*SEEDS]


@pytest.mark.slow
def test_a_store_is_read_and_extended(path: Path) -> None:
    with Store.open(path, IDENTITY, writable=True) as store:
        store.append(episode(99))
    store = Store.open(path)
    assert store._array("data/qpos").chunks[0] == 128
    for index, seed in enumerate([*SEEDS, 99]):
        assert_same(store.episode(index), episode(seed))


@pytest.mark.slow
def test_stores_are_merged_in_the_current_format(path: Path, tmp_path: Path) -> None:
    other = Store.create(tmp_path / "more.zarr", IDENTITY, AGENTS, (), 0, 0, OBJECTS, True, STATES_ONLY)
    with other:
        other.append(episode(2))
    merge([Store.open(path), other], tmp_path / "merged.zarr")
    merged = Store.open(tmp_path / "merged.zarr")
    assert (merged.attrs["format"], merged.seeds.tolist()) == (3, [2, *SEEDS])
    assert_same(merged.episode(0), episode(2))
