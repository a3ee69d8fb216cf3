"""What Weights & Biases is told: offline runs, read back from their files."""

import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from wandb.proto import wandb_internal_pb2

from rf_exp.ablation import GenerationRow, read_rows
from rf_exp.stages.logs import Rates
from tests.ablation.conftest import generation as rows_of

ROOT = Path(__file__).parents[2]
BLOCK, HEADER = 32768, 7  # bytes; LevelDB's log format: blocks of records (CRC, length, kind)


def records(path: Path) -> Iterator[Any]:
    """The records of an offline run."""
    content, at, begun = path.read_bytes(), HEADER, b""  # the file begins with a header of the same size
    while at + HEADER <= len(content):
        if BLOCK - at % BLOCK < HEADER:  # no room for a record: the rest of a block is padding
            at += BLOCK - at % BLOCK
            continue
        _, length, kind = struct.unpack("<IHB", content[at : at + HEADER])
        begun += content[at + HEADER : at + HEADER + length]
        at += HEADER + length
        if kind in (1, 4):  # whole, or the last part of one
            record = wandb_internal_pb2.Record()  # pyright: ignore[reportAttributeAccessIssue]
            record.ParseFromString(begun)
            begun = b""
            yield record


def runs(out: Path) -> dict[str, dict[str, Any]]:
    """Every offline run below `out`, by its name."""
    found = {}
    for path in sorted(out.glob("wandb/offline-run-*/run-*.wandb")):
        run: dict[str, Any] = {"history": [], "config": {}}
        for record in records(path):
            if record.HasField("run"):
                told = record.run
                run |= {"name": told.display_name, "group": told.run_group, "tags": list(told.tags)}
                run |= {"stage": told.job_type}
                run["config"] = {item.key: json.loads(item.value_json) for item in told.config.update}
            elif record.HasField("history"):
                items = record.history.item
                run["history"].append(
                    {item.key or ".".join(item.nested_key): json.loads(item.value_json) for item in items}
                )
        found[run["name"]] = run
    return found


def command(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WANDB_")}
    done = [sys.executable, "-m", "rf_exp.run", "recordings=0", "workers=1", *arguments]
    return subprocess.run(done, cwd=ROOT, env=kept | environment, capture_output=True, text=True, timeout=600)


GENERATE = ("stages=[generate]", "render=false", "task=place_food", "constraints=logical")


@pytest.fixture(scope="module")
def generation(tmp_path_factory) -> tuple[Path, list[str]]:
    """Three seeds of a row that fails now and then, in two goes; what was printed."""
    out = tmp_path_factory.mktemp("generation")
    printed = []
    for episodes in (2, 3):
        done = command(*GENERATE, f"episodes={episodes}", "seed=1", f"out={out}")
        assert done.returncode == 0, done.stderr
        printed += [done.stdout, done.stderr]
    return out, printed


@pytest.mark.slow
def test_a_generation_says_what_it_is_about(generation):
    found = runs(generation[0])
    assert list(found) == [f"generate place_food/logical, {n} episodes, seed 1" for n in (2, 3)]
    run = found["generate place_food/logical, 3 episodes, seed 1"]
    assert run["group"] == "place_food/logical, 3 episodes, seed 1"
    assert run["stage"] == "generate"
    assert set(run["tags"]) == {"place_food", "logical", "3 episodes", "seed 1"}
    config = run["config"]
    assert (config["task"], config["constraints"], config["arch"]) == ("place_food", "logical", None)
    assert (config["episodes"], config["seed"], config["first_scene_seed"]) == (3, 1, 1)
    assert config["row"] == {"name": "logical", "logical": True, "spatial": False, "temporal": False}
    assert config["brain"] == {"name": "scripted"}
    assert config["limits"]["velocity_rad_s"] == 0.9


@pytest.mark.slow
def test_a_generation_logs_the_rates_of_all_its_rows(generation):
    """Also of those that an earlier run made."""
    out, _ = generation
    rows = read_rows(out / "results/generate/place_food/logical-disturbed.jsonl", GenerationRow)
    first, second = (run["history"] for run in runs(out).values())
    assert [entry["_step"] for entry in first + second] == [1, 2, 3]
    for count, entry in enumerate(first + second, start=1):
        sofar = rows[:count]
        lengths = [row.steps for row in sofar if row.success]
        assert entry["success"] == pytest.approx(sum(row.success for row in sofar) / count)
        assert entry["success_paper"] == pytest.approx(sum(row.success_paper for row in sofar) / count)
        assert entry["with_violation"] == pytest.approx(sum(row.violations > 0 for row in sofar) / count)
        assert entry["violations"] == pytest.approx(sum(row.violations for row in sofar) / count)
        assert entry.get("steps") == (pytest.approx(sum(lengths) / len(lengths)) if lengths else None)


@pytest.mark.slow
def test_the_output_does_not_speak_of_the_service(generation):
    for text in generation[1]:
        assert "wandb" not in text.lower() and "weights" not in text.lower()


@pytest.mark.render
@pytest.mark.slow
def test_training_and_evaluation_say_what_they_are_about(tmp_path):
    sizes = (
        "demos=2",
        "scenes=2",
        "films=0",
        "task.lift_barrier.step_limit=20",
        "picture={width: 64, height: 48}",
        "training.steps=3",
        "policy.encoder.keypoints.steps=2",
        "policy.head.refined.regression_steps=2",
        "train_seed=7",
    )
    done = command(*sizes, "arch=separate_local", "training.batch_size=8", f"out={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert "wandb" not in (done.stdout + done.stderr).lower()
    found = runs(tmp_path)
    place, counted = "lift_barrier/full/separate_local", "fast, 2 demos, train seed 7"
    assert set(found) == {
        "generate lift_barrier/full, 2 demos, seed 0",
        f"train {place}/agent1, {counted}",
        f"train {place}/agent2, {counted}",
        f"evaluate {place}, {counted}",
    }
    for name, run in found.items():
        if run["stage"] == "generate":
            continue
        assert run["group"] == f"{place}, {counted}"
        assert set(run["tags"]) == {
            *("lift_barrier", "full", "separate_local"),
            *("fast", "2 demos", "train seed 7"),
        }
        config = run["config"]
        assert config["arch"]["name"] == "separate_local" and not config["arch"]["shared_policy"]
        assert (config["task"], config["constraints"], config["demos"]) == ("lift_barrier", "full", 2)
        assert (config["train_seed"], config["first_scene_seed"]) == (7, 1_000_000)
        assert config["training"]["steps"] == 3 and config["policy"]["width"] == 64
        if run["stage"] == "train":
            assert config["view"] in name
            assert all("loss" in entry for entry in run["history"])
    rows = found[f"evaluate {place}, {counted}"]["history"]
    assert [entry["_step"] for entry in rows] == [1, 2]
    assert {"success", "success_paper", "success_without_violation", "with_violation"} <= set(rows[-1])


def test_rates_count_every_row_and_lengths_only_successes():
    rates = Rates()
    task = "lift_barrier", "full"
    clean, mended = rows_of(*task, 1, 0, steps=100), rows_of(*task, 1, 0, steps=200, violations=(2,))
    for made in (*clean, *mended, *rows_of(*task, 0, 1, loose=1, steps=900)):
        rates.add(made)
    assert rates.figures() == {
        "success": 2 / 3,
        "success_paper": 1.0,
        "success_without_violation": 1 / 3,
        "with_violation": 1 / 3,
        "violations": 2 / 3,
        "steps": 150.0,
    }
    none = Rates()
    none.add(rows_of(*task, 0, 1)[0])
    assert "steps" not in none.figures()


@pytest.mark.slow
def test_a_blocked_folder_is_said_before_any_work(tmp_path):
    (tmp_path / "wandb").write_text("in the way")
    done = command(*GENERATE, "episodes=1", f"out={tmp_path}")
    assert done.returncode == 2
    assert "wandb=disabled" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "results/generate/place_food/logical-disturbed.jsonl").exists()


@pytest.mark.slow
def test_a_refused_run_names_the_way_out(tmp_path):
    """Online without a key."""
    nobody = {"HOME": str(tmp_path), "NETRC": str(tmp_path / "none")}
    done = command(*GENERATE, "episodes=1", "wandb=online", f"out={tmp_path}", **nobody)
    assert done.returncode == 1
    assert "wandb=offline" in done.stderr.splitlines()[-1] and "Traceback" not in done.stderr
