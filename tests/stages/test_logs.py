"""Logging of generation to Weights & Biases; for training and evaluation see tests/test_run.py."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rf_exp.ablation import GenerationRow, read_rows
from rf_exp.stages import cells
from rf_exp.stages.logs import Rates, run_settings
from tests.ablation.conftest import generation as rows_of
from tests.conftest import experiment
from tests.offline_runs import runs

ROOT = Path(__file__).parents[2]


def command(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WANDB_")}
    done = [sys.executable, "-m", "rf_exp.run", "recordings=0", "workers=1", *arguments]
    return subprocess.run(done, cwd=ROOT, env=kept | environment, capture_output=True, text=True, timeout=600)


GENERATE = ("stages=[generate]", "render=false", "task=place_food", "constraints=logical")


@pytest.fixture(scope="module")
def generation(tmp_path_factory) -> tuple[Path, list[str]]:
    """Output folder of three seeds of a row that sometimes fails, generated in two runs; and their output."""
    out = tmp_path_factory.mktemp("generation")
    printed = []
    for episodes in (2, 3):
        done = command(*GENERATE, f"episodes={episodes}", "seed=1", f"out={out}")
        assert done.returncode == 0, done.stderr
        printed += [done.stdout, done.stderr]
    return out, printed


@pytest.mark.slow
def test_a_generation_is_logged_with_its_name_tags_and_config(generation):
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
    """Including those of an earlier run."""
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
def test_the_output_does_not_mention_the_service(generation):
    for text in generation[1]:
        assert "wandb" not in text.lower() and "weights" not in text.lower()


def test_the_name_of_a_generation_has_its_number_of_demonstrations() -> None:
    (cell,) = cells(experiment("task=lift_barrier", "demos=2"))
    settings = run_settings(cell, "generate")
    assert settings["name"] == "generate lift_barrier/full, 2 demos, seed 0"
    assert settings["tags"] == ["lift_barrier", "full", "2 demos", "seed 0"]


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
def test_a_blocked_folder_is_reported_before_any_work(tmp_path):
    (tmp_path / "wandb").write_text("in the way")
    done = command(*GENERATE, "episodes=1", f"out={tmp_path}")
    assert done.returncode == 2
    assert "wandb=disabled" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "results/generate/place_food/logical-disturbed.jsonl").exists()


@pytest.mark.slow
def test_a_refused_run_names_the_alternative(tmp_path):
    """Online without a key."""
    nobody = {"HOME": str(tmp_path), "NETRC": str(tmp_path / "none")}
    done = command(*GENERATE, "episodes=1", "wandb=online", f"out={tmp_path}", **nobody)
    assert done.returncode == 1
    assert "wandb=offline" in done.stderr.splitlines()[-1] and "Traceback" not in done.stderr
