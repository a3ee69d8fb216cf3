"""Rows of policies go into results/ a training seed at a time, whole, never beside what they are unlike."""

import csv
import json
import runpy
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, append_row, read_rows
from rf_exp.errors import ArgumentError
from tests.ablation.conftest import evaluation

SCRIPT = Path(__file__).parents[2] / "scripts" / "publish.py"
PLACE = Path("results/evaluate/lift_barrier/separate_local")
STEM = "full-fast-50"
SCENES = 4


def measured(out: Path, seed: int, wins: int, *, scenes: int = SCENES, steps: int = 100) -> None:
    """A training seed with so many successes, evaluated for at most `steps`."""
    for row in evaluation(
        "lift_barrier", "separate_local", 50, wins, scenes - wins, train_seed=seed, recipe="fast"
    ):
        append_row(out / PLACE / f"{STEM}.jsonl", row)
    (out / PLACE / f"{STEM}.configuration.json").write_text(json.dumps({"step_limit": steps}))
    (out / PLACE / f"{STEM}-{seed}.configuration.json").write_text(json.dumps({"of": wins}))


def publish(out: Path, results: Path) -> None:
    runpy.run_path(str(SCRIPT))["publish"](out, results, SCENES)


def won(results: Path) -> dict[int, int]:
    """Training seed -> successes."""
    rows = read_rows(results / PLACE.relative_to("results") / f"{STEM}.jsonl", EvaluationRow)
    return {r.train_seed: sum(row.success for row in rows if row.train_seed == r.train_seed) for r in rows}


def test_training_seeds_come_beside_those_that_are_there_and_take_the_place_of_the_same(
    tmp_path: Path,
) -> None:
    first, later, results = tmp_path / "first", tmp_path / "later", tmp_path / "results"
    measured(first, 0, 1)
    measured(first, 1, 2)
    measured(later, 1, 3)
    measured(later, 2, 4)
    publish(first, results)
    assert won(results) == {0: 1, 1: 2}
    publish(later, results)
    assert won(results) == {0: 1, 1: 3, 2: 4}
    of = [json.loads((results / PLACE.relative_to("results") / f"{STEM}-{k}.configuration.json").read_text())
          for k in range(3)]  # fmt: skip
    assert of == [{"of": 1}, {"of": 3}, {"of": 4}]


def test_what_was_evaluated_otherwise_goes(tmp_path: Path) -> None:
    results = tmp_path / "results"
    measured(tmp_path / "first", 0, 1)
    measured(tmp_path / "later", 1, 2, steps=120)
    for out in ("first", "later"):
        publish(tmp_path / out, results)
    assert won(results) == {1: 2}
    assert not (results / PLACE.relative_to("results") / f"{STEM}-0.configuration.json").exists()


def test_rows_of_which_nobody_knows_what_they_were_made_of_go(tmp_path: Path) -> None:
    results = tmp_path / "results"
    measured(tmp_path / "first", 0, 1)
    publish(tmp_path / "first", results)
    (results / PLACE.relative_to("results") / f"{STEM}.configuration.json").unlink()
    measured(tmp_path / "later", 1, 2)
    publish(tmp_path / "later", results)
    assert won(results) == {1: 2}


def test_an_unfinished_seed_is_told_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured(tmp_path / "out", 0, 2)
    measured(tmp_path / "out", 1, 1, scenes=SCENES - 1)
    publish(tmp_path / "out", tmp_path / "results")
    assert "training seed 1 is not finished" in " ".join(capsys.readouterr().out.split())
    assert won(tmp_path / "results") == {0: 2}
    with pytest.raises(ArgumentError, match="no rows of policies below"):
        publish(tmp_path / "nothing", tmp_path / "results")


def test_curves_are_means_over_many_steps(tmp_path: Path) -> None:
    out = tmp_path / "out"
    measured(out, 0, 2)
    learned = out / "policies" / "lift_barrier" / "full" / "separate_local" / "fast-50-0" / "agent1"
    learned.mkdir(parents=True)
    steps = [f"{step},{step / 20:g},{step / 10:g}" for step in range(20, 281, 20)]
    (learned / "curves.csv").write_text("\n".join(["step,loss,core_s", *steps]))
    publish(out, tmp_path / "results")
    path = tmp_path / "results" / PLACE.relative_to("results") / f"{STEM}-0.curves.csv"
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [
        ["policy", "step", "loss", "core_s"],
        ["agent1", "200", "5.5", "20"],
        ["agent1", "280", "12.5", "28"],
    ]
