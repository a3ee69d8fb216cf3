"""Shards: what they come to is what one go makes, byte for byte, and what is no shard of ours is refused."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rf_exp.ablation import GenerationRow, read_rows
from rf_exp.errors import StageError
from rf_exp.experiment import Experiment
from rf_exp.stages import generate_data
from rf_exp.stages.shards import IDENTITY_FILE, Shards, existing_shards, make_shard, plan_shards
from rf_exp.store import Store
from tests.conftest import cell_of, experiment

ARGUMENTS = ("task=pick_meat", "stages=[generate]", "render=false", "recordings=0", "wandb=disabled")
LOKY = ("launch.engine=loky", "launch.shard_seeds=2", "workers=2")
SEEDS = 3


def asked(out: Path, *more: str) -> Experiment:
    return experiment(*ARGUMENTS, *more, f"out={out}")


def made(asked: Experiment) -> int:
    return generate_data(cell_of(asked))


def shards(asked: Experiment) -> Shards:
    return Shards(cell_of(asked), generate_data)


def content(asked: Experiment) -> tuple[dict[str, bytes], list[GenerationRow]]:
    """The files of the store, and the rows but for their times."""
    path = cell_of(asked).data_path
    files = {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}
    told = read_rows(cell_of(asked).generation_path, GenerationRow)
    return files, [replace(row, wall_s=0.0) for row in told]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """Three seeds in one go, by processes of this machine."""
    one = asked(tmp_path_factory.mktemp("whole"), f"episodes={SEEDS}")
    assert made(one) == SEEDS
    return one


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """The last two of them, as somebody has made them in an `out` of their own."""
    one = asked(tmp_path_factory.mktemp("later"), "seed=1", "episodes=2")
    assert made(one) == 2
    return one


@example(seeds={0, 1, 2}, there=[(0, 1), (1, 1), (0, 3)], size=1, wanted=None)
@given(
    seeds=st.sets(st.integers(0, 30)),
    there=st.lists(st.tuples(st.integers(0, 30), st.integers(1, 9)), max_size=4),
    size=st.integers(1, 7),
    wanted=st.none() | st.integers(1, 40),
)
def test_blocks_hold_what_is_wanted_and_nothing_twice(seeds, there, size, wanted) -> None:
    known = [range(first, first + length) for first, length in there]
    ordered = sorted(seeds)
    found = plan_shards(ordered, known, size, wanted)
    needed = ordered[:wanted]
    assert [seed for seed in needed if not any(seed in block for block in found)] == []
    assert all(any(seed in block for seed in needed) for block in found)  # none for nothing
    new = [block for block in found if block not in known]
    for block in new:
        assert len(block) <= size and {*block} <= seeds
        assert not any(seed in other for seed in block for other in known)
    assert sum(map(len, new)) == len({seed for block in new for seed in block})
    starts = [next(seed for seed in ordered if seed in block) for block in found]
    assert starts == sorted(starts)


@pytest.mark.slow
def test_finished_shards_are_put_together_and_not_made_again(whole, tmp_path, capsys) -> None:
    one = asked(tmp_path, *LOKY, f"episodes={SEEDS}")
    folder = shards(one).folder
    shutil.copytree(whole.out, folder / "0-2")
    assert made(one) == SEEDS
    assert content(one) == content(whole)
    assert "0 of 1 shards are made by loky" in capsys.readouterr().out
    assert not folder.exists()


@pytest.mark.slow
def test_of_a_shard_only_what_is_wanted_is_taken_and_the_rest_stays(whole, tmp_path) -> None:
    one = asked(tmp_path, *LOKY, "demos=2")
    folder = shards(one).folder
    shutil.copytree(whole.out, folder / "0-2")
    assert made(one) == 2
    assert Store.open(cell_of(one).data_path).seeds.tolist() == [0, 1]
    assert existing_shards(folder) == [range(3)]
    assert made(replace(one, demos=SEEDS)) == SEEDS
    assert content(one) == content(whole)
    assert not folder.exists()


@pytest.mark.slow
def test_shards_that_overlap_and_leave_a_gap_come_to_the_same(whole, later, tmp_path, capsys) -> None:
    """What is missing is made, by loky; of what is there twice one is taken."""
    one = asked(tmp_path, *LOKY, f"episodes={SEEDS}")
    folder = shards(one).folder
    shutil.copytree(later.out, folder / "1-2")
    last = replace(one, seed=2, episodes=1, out=folder / "2-2", launch=whole.launch)
    assert made(last) == 1
    assert made(one) == SEEDS
    assert content(one) == content(whole)
    assert "1 of 2 shards are made by loky" in capsys.readouterr().out
    assert existing_shards(folder) == [range(2, 3)]  # which nobody has needed


@pytest.mark.slow
def test_a_seed_that_hangs_in_a_shard_is_a_row_with_its_reason(tmp_path) -> None:
    one = asked(tmp_path, *LOKY, "episodes=2", "seed_limit_s=1")  # no process starts in a second
    assert made(one) == 0
    told = content(one)[1]
    assert [(row.seed, row.success) for row in told] == [(0, False), (1, False)]
    assert all(row.reason.startswith("no result after 1 s; its process, ") for row in told)


def other_configuration(shard: Path) -> None:
    path = next(shard.rglob("*.zarr")) / "zarr.json"
    said = json.loads(path.read_text())
    said["attributes"]["identity"]["limits"]["velocity_rad_s"] = 0.5
    path.write_text(json.dumps(said))


def without_an_episode(shard: Path) -> None:
    """The store of two seeds, and rows of three: what a disk that was full may have left of a copy."""
    store = next(shard.rglob("*.zarr"))
    array, path = store / "meta/episode_ends", store / "meta/episode_ends/zarr.json"
    said = json.loads(path.read_text())
    said["shape"] = [SEEDS - 1]
    path.write_text(json.dumps(said))
    assert array.is_dir()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (other_configuration, "another configuration (limits.velocity_rad_s: found 0.5, wanted 0.9)"),
        (without_an_episode, "has rows of the seeds [0, 1, 2] and demonstrations of [0, 1]; expected a row"),
    ],
)
def test_what_is_no_shard_of_ours_is_refused(
    harm: Callable[[Path], None], message: str, whole, tmp_path
) -> None:
    one = asked(tmp_path, *LOKY, f"episodes={SEEDS}")
    shard = shards(one).folder / "0-2"
    shutil.copytree(whole.out, shard)
    harm(shard)
    with pytest.raises(StageError) as caught:
        made(one)
    assert message in str(caught.value) and str(shard) in str(caught.value)
    assert shard.is_dir()


def test_a_machine_that_does_not_see_the_folder_says_so(tmp_path) -> None:
    all_shards = shards(asked(tmp_path, "episodes=2"))
    with pytest.raises(
        StageError, match=r"does not see .*`out` has to be on a file system that all machines"
    ):
        make_shard(all_shards.shard_for(range(2)), all_shards.identity)


def test_a_machine_with_other_code_makes_nothing(tmp_path) -> None:
    all_shards = shards(asked(tmp_path, "episodes=2"))
    all_shards.folder.mkdir(parents=True)
    (all_shards.folder / IDENTITY_FILE).touch()
    wanted = {**all_shards.identity, "generator": "0.9"}
    with pytest.raises(StageError, match=r"would make other demonstrations \(generator: found .*, wanted"):
        make_shard(all_shards.shard_for(range(2)), wanted)
    assert existing_shards(all_shards.folder) == []
