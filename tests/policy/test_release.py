"""What a release carries: policies in half the bytes that act as the whole ones do, and what judges them."""

import os
import runpy
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import read_experiment
from rf_exp.policy import MODEL, PolicyConfig, Stream, TrainConfig, View, load_policy, train, write_small
from rf_exp.store import Store
from tests.children import small_files
from tests.conftest import CONF

LOCAL = View("agent1", (Stream("agent1", (1,)),))
SCRIPT = Path(__file__).parents[2] / "scripts" / "release.py"
PLACE = Path("lift_barrier/full/separate_local/fast-50-0/agent1")


@pytest.fixture
def out(
    make_store: Callable[[int, int], Store],
    policy_config: PolicyConfig,
    train_config: TrainConfig,
    tmp_path: Path,
) -> Path:
    out = tmp_path / "outputs"
    train(make_store(2, 3), LOCAL, policy_config, train_config, out / "policies" / PLACE)
    rows = out / "results" / "generate" / "lift_barrier"
    rows.mkdir(parents=True)
    for name in ("full.jsonl", "full-disturbed.jsonl", "full-disturbed.configuration.json", "logical.jsonl"):
        (rows / name).write_text("{}")
    return out


def release(folder: Path, to: Path) -> Path:
    return runpy.run_path(str(SCRIPT))["release"](folder, to)


@pytest.mark.slow
def test_the_small_copy_of_a_policy_acts_as_the_whole_one(out: Path, tmp_path: Path) -> None:
    whole = out / "policies" / PLACE
    small = write_small(whole, tmp_path / "small")
    assert (small / MODEL).stat().st_size < 0.6 * (whole / MODEL).stat().st_size
    (one, view, senses), (other, *rest) = load_policy(whole, "cpu"), load_policy(small, "cpu")
    assert rest == [view, senses]
    for weight, half in zip(one.state_dict().values(), other.state_dict().values(), strict=True):
        assert half.dtype == weight.dtype
        torch.testing.assert_close(half, weight, atol=0, rtol=2**-8)


@pytest.mark.slow
def test_a_release_is_the_part_of_outputs_that_evaluation_needs(out: Path, tmp_path: Path) -> None:
    packed = release(out / "policies" / PLACE.parent, tmp_path)
    assert packed == tmp_path / "lift_barrier-separate_local-fast-50-0.zip"
    with zipfile.ZipFile(packed) as file:
        found = {name for name in file.namelist() if not name.endswith("/")}
        file.extractall(tmp_path / "released")
    policy = {f"policies/{PLACE}/{name}" for name in (MODEL, "config.json", "curves.csv")}
    assert found == policy | {"experiment/released.yaml"} | {
        f"results/generate/lift_barrier/{name}"
        for name in ("full.jsonl", "full-disturbed.jsonl", "full-disturbed.configuration.json")
    }
    load_policy(tmp_path / "released" / "policies" / PLACE, "cpu")


@pytest.mark.slow
def test_the_same_release_has_the_same_bytes_whenever_it_is_made(out: Path, tmp_path: Path) -> None:
    first = release(out / "policies" / PLACE.parent, tmp_path / "first").read_bytes()
    for path in out.rglob("*"):
        os.utime(path, (1e9, 1e9))
    assert release(out / "policies" / PLACE.parent, tmp_path / "again").read_bytes() == first


@pytest.mark.slow
@pytest.mark.parametrize("limit", [1_000, 30_000])  # of the first file that is copied; of a policy or the zip
def test_a_full_disk_or_a_size_that_is_too_large_leaves_the_release_that_was_there(
    out: Path, tmp_path: Path, limit: int
) -> None:
    packed = release(out / "policies" / PLACE.parent, tmp_path / "to")
    good = packed.read_bytes()
    assert len(good) > limit
    with small_files(limit), pytest.raises((OSError, StageError), match="File too large"):
        release(out / "policies" / PLACE.parent, tmp_path / "to")
    script = runpy.run_path(str(SCRIPT))
    script["release"].__globals__["LARGEST_MB"] = 0.01
    with pytest.raises(ArgumentError, match=r"a release carries at most 0\.01"):
        script["release"](out / "policies" / PLACE.parent, tmp_path / "to")
    assert packed.read_bytes() == good
    assert os.listdir(tmp_path / "to") == [packed.name]


@pytest.mark.slow
def test_its_experiment_asks_for_policies_that_learned_so(
    out: Path, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    shutil.unpack_archive(release(out / "policies" / PLACE.parent, tmp_path), tmp_path / "released")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        found = f"hydra.searchpath=[file://{tmp_path}/released]", "experiment=released"
        node = OmegaConf.to_container(compose("config", [*found]), resolve=True)
    experiment = read_experiment(node)  # pyright: ignore[reportArgumentType]
    assert experiment.policy == policy_config
    assert experiment.training.identity == replace(train_config, seed=0).identity
    assert experiment.train_seed == 0
    assert experiment.policies == PLACE.parent.name


@pytest.mark.slow
def test_what_is_no_folder_of_policies_is_refused(out: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="is not the folder of trained policies; expected one such as"):
        release(out / "policies" / PLACE, tmp_path)  # of one agent alone
    assert not list(tmp_path.glob("*.zip"))
