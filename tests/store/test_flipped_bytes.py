"""One byte that a disk has flipped: which episodes it costs, whichever file it is in."""

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from rf_exp.store import Damage, DamagedStore, Store, merge
from rf_exp.types import Episode
from tests.store.episodes import AGENTS, IDENTITY, OBJECTS, assert_same
from tests.test_data import DESCRIPTION, described
from tests.test_rescue import digest, flip

SEEDS, STEPS = range(3, 13), 95  # as long as demonstrations of Lift Barrier are
STATES_ONLY = replace(DESCRIPTION, camera_models={}, depth=False, labels=())
COSTS = {  # of one byte, in episodes of 10, at most
    "data/qpos": 3, "data/time_s": 0, "meta/certificate": 1, "meta/seed": 0, "meta/episode_ends": 0
}  # fmt: skip


def episode(seed: int) -> Episode:
    """The states of one, and a certificate unlike others, with the row of the attempt as generation does."""
    made = described(seed, STEPS)
    certificate = {**made.certificate, "row": {"seed": seed}, "checks": made.qpos[:20].tolist()}
    return replace(made, images={}, extras={}, certificate=certificate)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "s.zarr"
    with Store.create(path, IDENTITY, AGENTS, (), 0, 0, OBJECTS, True, STATES_ONLY) as store:
        for seed in SEEDS:
            store.append(episode(seed))
    return path


@pytest.fixture
def path(written: Path, tmp_path: Path) -> Path:
    return shutil.copytree(written, tmp_path / "s.zarr")


def kept(path: Path) -> list[int]:
    """The seeds of the episodes that can be read of a damaged store, each of them the one that was stored."""
    found = []
    with TemporaryDirectory() as frame:
        damaged = DamagedStore(path, Path(frame))
        for index in range(len(damaged.ends)):
            with suppress(Damage):
                read = damaged.episode(index)
                assert_same(read, episode(read.seed))
                found.append(read.seed)
    return found


@pytest.mark.slow
def test_a_flipped_byte_costs_the_episodes_of_its_chunk_and_no_other(path: Path) -> None:
    for name, cost in COSTS.items():
        file = min(each for each in (path / name / "c").rglob("*") if each.is_file())
        whole = file.read_bytes()
        flip(file)
        before = digest(path)
        assert len(SEEDS) - len(kept(path)) <= cost, name
        assert digest(path) == before, f"{name}: the damaged store is touched"
        with pytest.raises(Damage):
            assert Store.open(path).certificates
        file.write_bytes(whole)
    assert kept(path) == [*SEEDS]


@pytest.mark.slow
def test_a_store_is_read_and_gone_on_with(path: Path) -> None:
    with Store.open(path, IDENTITY, writable=True) as store:
        store.append(episode(99))
    store = Store.open(path)
    assert store._array("data/qpos").chunks[0] == 128
    for index, seed in enumerate([*SEEDS, 99]):
        assert_same(store.episode(index), episode(seed))


@pytest.mark.slow
def test_parts_are_merged_into_one_of_today(path: Path, tmp_path: Path) -> None:
    more = Store.create(tmp_path / "more.zarr", IDENTITY, AGENTS, (), 0, 0, OBJECTS, True, STATES_ONLY)
    with more:
        more.append(episode(2))
    merge([Store.open(path), more], tmp_path / "merged.zarr")
    merged = Store.open(tmp_path / "merged.zarr")
    assert (merged.attrs["format"], merged.seeds.tolist()) == (3, [2, *SEEDS])
    assert_same(merged.episode(0), episode(2))
