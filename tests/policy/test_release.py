"""Releases: policies in half the bytes that act as the original ones, and the rows that evaluation needs."""

import os
import re
import runpy
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import read_experiment
from rf_exp.policy import (
    MODEL,
    PolicyConfig,
    Stream,
    TrainConfig,
    View,
    load_policy,
    read_recipe,
    train,
    write_small,
)
from rf_exp.release import EXPERIMENT, expand_release, read_release
from rf_exp.store import Store
from tests.children import small_files
from tests.conftest import CONF
from tests.policy.conftest import paper_policy, training_of

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
def test_the_small_copy_of_a_policy_has_the_same_weights_at_half_precision(out: Path, tmp_path: Path) -> None:
    whole = out / "policies" / PLACE
    small = write_small(whole, tmp_path / "small")
    assert (small / MODEL).stat().st_size < 0.6 * (whole / MODEL).stat().st_size
    (one, view, spec), (other, *rest) = load_policy(whole, "cpu"), load_policy(small, "cpu")
    assert rest == [view, spec]
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
@pytest.mark.parametrize("limit", [1_000, 30_000])  # hit by the first copied file; by a policy or the ZIP
def test_a_full_disk_or_a_size_that_is_too_large_leaves_the_release_that_was_there(
    out: Path, tmp_path: Path, limit: int
) -> None:
    packed = release(out / "policies" / PLACE.parent, tmp_path / "to")
    good = packed.read_bytes()
    assert len(good) > limit
    with small_files(limit), pytest.raises((OSError, StageError), match="File too large"):
        release(out / "policies" / PLACE.parent, tmp_path / "to")
    script = runpy.run_path(str(SCRIPT))
    script["release"].__globals__["MAX_MB"] = 0.01
    with pytest.raises(ArgumentError, match=r"a release carries at most 0\.01"):
        script["release"](out / "policies" / PLACE.parent, tmp_path / "to")
    assert packed.read_bytes() == good
    assert os.listdir(tmp_path / "to") == [packed.name]


@pytest.mark.slow
def test_the_experiment_of_a_release_selects_its_policies(
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
def test_the_folder_of_a_single_agent_is_refused(out: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="is not the folder of trained policies; expected one such as"):
        release(out / "policies" / PLACE, tmp_path)  # that of a single agent
    assert not list(tmp_path.glob("*.zip"))


# -- reading releases from others ------------------------------------------------------------------------


def said() -> dict[str, Any]:
    """The content of the experiment file of a release."""
    policy, training = paper_policy().identity, training_of().identity
    del training["seed"]
    chosen = {"task": "lift_barrier", "constraints": "full", "arch": "separate_local"}
    return {
        "defaults": [{f"override /{group}": value} for group, value in chosen.items()],
        "stages": ["evaluate", "report"],
        **{"recipe": "fast+dagger1", "demos": 50, "train_seed": 1, "disturbance_rad": 0.1, "delay_s": 0.5},
        "picture": {side: policy.pop(side) for side in ("width", "height")},
        "policy": policy,
        "training": training,
    }


def packed(folder: Path, text: str | dict[str, Any]) -> Path:
    """The folder of a release with this experiment file."""
    file = folder / EXPERIMENT
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text if isinstance(text, str) else OmegaConf.to_yaml(OmegaConf.create(text)), "utf-8")
    return folder


@pytest.mark.slow
def test_the_documented_command_uses_the_experiment_of_a_release(command: Any, tmp_path: Path) -> None:
    """Its other files are ignored, although Hydra would read every one of them."""
    folder, marker = packed(tmp_path / "released", said()), tmp_path / "ran"
    runs = f"{{callbacks: {{x: {{_target_: os.mkdir, path: {marker}}}}}}}"
    for name, text in {
        "config.yaml": f"hydra: {runs}",
        "hydra/config.yaml": runs[1:-1],
        "hydra/launcher/basic.yaml": f"_target_: os.mkdir\npath: {marker}",
        "task/lift_barrier.yaml": "lift_barrier: {code: antigravity}",
        "policy/fast.yaml": f"hydra: {runs}",
        "profile/quick.yaml": f"# @package _global_\nhydra: {runs}",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    arguments = "--config-dir", str(folder), "experiment=released", f"out={folder}"
    done = command(*arguments, "scenes=7")
    assert done.returncode == 1 and "no trained policy in " in done.stderr, done.stderr
    [kept] = folder.glob("runs/*/*/.hydra/config.yaml")
    config: Any = OmegaConf.load(kept)
    values: Any = OmegaConf.to_container(config)
    assert (config.scenes, config.demos, config.recipe, config.train_seed) == (7, 50, "fast+dagger1", 1)
    assert config.stages == ["evaluate", "report"] and list(config.task) == ["lift_barrier"]
    assert read_recipe(values["policy"], values["picture"]) == paper_policy()
    assert not marker.exists()


@pytest.mark.slow
def test_the_command_line_overrides_a_release(command: Any, tmp_path: Path) -> None:
    folder = packed(tmp_path / "released", said())
    given = "task=pick_meat", "stages=[report]", "policy.acting.deadband_rad=0.02"
    done = command(*given, f"--config-dir={folder}", "experiment=released", f"out={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    [kept] = tmp_path.glob("out/runs/*/*/.hydra/config.yaml")
    config: Any = OmegaConf.load(kept)
    assert list(config.task) == ["pick_meat"] and config.stages == ["report"]
    assert config.policy.acting.deadband_rad == 0.02 and config.demos == 50


@pytest.mark.slow
@pytest.mark.parametrize(
    "named", ["experiment=released", "+experiment=released", "experiment=ablation,released"]
)
@pytest.mark.parametrize("by", ["--config-dir", "hydra.searchpath"])
def test_no_code_of_a_release_is_run(command: Any, tmp_path: Path, named: str, by: str) -> None:
    marker = tmp_path / "ran"
    foreign = {"name": "x", "factory": "os:mkdir", "options": {"path": str(marker)}, "step_limit": 3}
    foreign["observations"] = {"pictures": False}
    text = OmegaConf.to_yaml(OmegaConf.create({**said(), "foreign": foreign}))
    folder = packed(tmp_path / "released", f"# @package _global_\n{text}")
    where = [f"{by}={folder}"] if by.startswith("--") else [f"hydra.searchpath=[file://{folder}]"]
    done = command(
        *where, named, f"out={tmp_path}/out", "render=false", "scenes=1", "films=0", "recordings=0"
    )
    assert done.returncode == 2 and not marker.exists()
    alone = by.startswith("--") and named == "experiment=released"
    assert ("it sets 'foreign'; a release says" if alone else "is read from a folder, alone") in done.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hydra": {"callbacks": {"x": {"_target_": "os.mkdir"}}}}, "it sets 'hydra'"),
        ({"foreign": {"factory": "os:system"}}, "it sets 'foreign'"),
        ({"out": "/"}, "it sets 'out'"),
        ({"launch": {"engine": "dask"}}, "it sets 'launch'"),
        ({"brain": {"base_url": "http://x"}}, "it sets 'brain'"),
        ({"task": {"lift_barrier": {"code": "os"}}}, "it sets 'task'"),
        ({"defaults": [{"override /task": "lift_barrier"}]}, "defaults are"),
        ({"defaults": [*said()["defaults"], "evil"]}, "defaults"),
        ({"defaults": [*said()["defaults"], {"override /hydra/launcher": "joblib"}]}, "defaults are"),
        ({"defaults": [{"override /task": "../x"}, *said()["defaults"][1:]]}, "task is '../x'; expected"),
        ({"defaults": [{"override /task": ["a"]}, *said()["defaults"][1:]]}, "defaults"),
        ({"stages": ["train"]}, "stages are ['train']; possible are evaluate, report"),
        ({"stages": []}, "stages are []"),
        ({"recipe": "${oc.env:HOME}"}, "recipe is '${oc.env:HOME}'; expected a name"),
        ({"recipe": "a' out='/"}, "expected a name"),
        ({"recipe": 3}, "recipe"),
        ({"demos": 10**9}, "demos is 1000000000; expected 1 to 1e+06"),
        ({"demos": True}, "demos is True"),
        ({"train_seed": -1}, "train_seed is -1"),
        ({"disturbance_rad": float("nan")}, "disturbance_rad is nan"),
        ({"delay_s": float("inf")}, "delay_s is inf"),
        ({"picture": {"width": 10**9, "height": 48}}, "width is 1000000000; expected finite"),
        ({"picture": {"width": 64}}, "height"),
        ({"policy": said()["policy"] | {"horizon": 10**9}}, "horizon is 1000000000"),
        ({"policy": said()["policy"] | {"horizon": "${oc.env:HOME}"}}, "horizon"),
        ({"policy": said()["policy"] | {"code": "antigravity"}}, "can not match \"code\""),
        ({"policy": said()["policy"] | {"head": {"name": "antigravity"}}}, "unknown head 'antigravity'"),
        ({"policy": said()["policy"] | {"encoder": {"name": ["os"]}}}, "expected a mapping with a name"),
        ({"policy": "fast"}, "policy"),
        ({"training": said()["training"] | {"device": "cuda:x"}}, "device"),
        ({"training": said()["training"] | {"steps": 1e99}}, "steps"),
    ],
)  # fmt: skip
def test_other_keys_and_values_of_a_release_are_refused(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ArgumentError, match=re.escape(message)) as refused:
        read_release(packed(tmp_path, {**said(), **change}))
    assert f"{EXPERIMENT} is no experiment of a release: " in str(refused.value)
    assert str(Path.home()) not in str(refused.value).replace(str(tmp_path), "")


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "3", "\x1b[2J", "a: !!python/object/apply:os.mkdir [ran]", "[" * 60_000, "a: " * 50_000,
        "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]", "x" * 10**6,
    ],
)  # fmt: skip
def test_files_that_are_no_experiment_are_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="is no experiment of a release") as refused:
        read_release(packed(tmp_path, text))
    assert str(refused.value).isprintable() and len(str(refused.value)) < 5000


def test_links_out_of_a_release_are_refused(tmp_path: Path) -> None:
    folder = packed(tmp_path / "released", said())
    (folder / "results").mkdir()
    (folder / "results" / "evaluate").symlink_to(tmp_path)
    with pytest.raises(ArgumentError, match="is a link out of the release"):
        read_release(folder)


def test_a_release_is_evaluated_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "lift_barrier.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.write(packed(tmp_path / "made", said()) / EXPERIMENT, EXPERIMENT)
        file.writestr("../beside.txt", "no")
    for _ in range(2):  # the second time it is unpacked already
        found = expand_release(["--config-dir", str(path), "experiment=released", "scenes=3"])
        assert {"scenes=3", f"out={tmp_path}/lift_barrier", "task=lift_barrier"} <= set(found)
    assert not (tmp_path / "beside.txt").exists() and (tmp_path / "lift_barrier" / EXPERIMENT).exists()
    assert f"out={tmp_path}/x" in expand_release(
        ["-cd", str(path), "experiment=released", f"out={tmp_path}/x"]
    )


def test_invalid_release_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.zip"
    path.write_bytes(b"nothing")
    with pytest.raises(ArgumentError, match=r"x\.zip cannot be unpacked: File is not a zip file"):
        expand_release(["--config-dir", str(path), "experiment=released"])
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("zeros", bytes(2**20))
    monkeypatch.setattr("rf_exp.release.MAX_UNPACKED_BYTES", 2**20 - 1)
    with pytest.raises(ArgumentError, match="holds 1048576 bytes; a release has at most 1048575"):
        expand_release(["--config-dir", str(path), "experiment=released"])
    assert os.listdir(tmp_path) == ["x.zip"]


def test_without_a_release_arguments_stay_as_they_are(tmp_path: Path) -> None:
    for arguments in (
        ["task=place_food", "-m"],
        ["--config-dir", "x", "experiment=ablation"],
        ["name=released"],
    ):
        assert expand_release(arguments) == arguments
    with pytest.raises(
        ArgumentError, match=r"experiment/released.yaml is no experiment of a release: .*No such"
    ):
        expand_release(["--config-dir", str(tmp_path), "experiment=released"])
