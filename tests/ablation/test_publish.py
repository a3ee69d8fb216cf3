"""Publishing rows of policies: whole training seeds, never beside rows of another configuration."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import (
    PUBLISHED,
    EvaluationRow,
    GenerationRow,
    Published,
    append_row,
    read_published,
    read_rows,
    write_published,
)
from rf_exp.errors import ArgumentError
from tests.ablation.conftest import evaluation, generation

SCRIPT = Path(__file__).parents[2] / "scripts" / "publish.py"
PLACE = Path("results/evaluate/lift_barrier/separate_local")
STEM = "full-fast-50"
CELL = PLACE.relative_to("results") / f"{STEM}{PUBLISHED}"
SCENES = 4


def measured(out: Path, seed: int, wins: int, *, scenes: int = SCENES, steps: int = 100) -> None:
    """Writes rows of a training seed with `wins` successes, evaluated for at most `steps`."""
    for row in evaluation(
        "lift_barrier", "separate_local", 50, wins, scenes - wins, train_seed=seed, recipe="fast"
    ):
        append_row(out / PLACE / f"{STEM}.jsonl", row)
    (out / PLACE / f"{STEM}.configuration.json").write_text(json.dumps({"step_limit": steps}))
    (out / PLACE / f"{STEM}-{seed}.configuration.json").write_text(json.dumps({"of": wins}))


def publish(out: Path, results: Path) -> None:
    runpy.run_path(str(SCRIPT))["publish"](out, results, SCENES)


def published(results: Path) -> Published[EvaluationRow]:
    return read_published(results / CELL, EvaluationRow)


def won(results: Path) -> dict[int, int]:
    """Training seed -> successes."""
    rows = published(results).rows
    return {r.train_seed: sum(row.success for row in rows if row.train_seed == r.train_seed) for r in rows}


def test_training_seeds_are_added_and_replace_the_same_seeds(
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
    assert published(results).made == {0: {"of": 1}, 1: {"of": 3}, 2: {"of": 4}}


def test_rows_of_another_configuration_are_dropped(tmp_path: Path) -> None:
    results = tmp_path / "results"
    measured(tmp_path / "first", 0, 1)
    measured(tmp_path / "later", 1, 2, steps=120)
    for out in ("first", "later"):
        publish(tmp_path / out, results)
    assert won(results) == {1: 2}
    assert published(results).made == {1: {"of": 2}} and published(results).asked == {"step_limit": 120}


def test_rows_without_a_configuration_are_dropped(tmp_path: Path) -> None:
    results = tmp_path / "results"
    measured(tmp_path / "first", 0, 1)
    publish(tmp_path / "first", results)
    write_published(results / CELL, replace(published(results), asked={}))
    measured(tmp_path / "later", 1, 2)
    publish(tmp_path / "later", results)
    assert won(results) == {1: 2}


def test_an_unfinished_seed_is_reported_and_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(tmp_path / "out", 0, 2)
    measured(tmp_path / "out", 1, 1, scenes=SCENES - 1)
    publish(tmp_path / "out", tmp_path / "results")
    assert "training seed 1 is not finished" in " ".join(capsys.readouterr().out.split())
    assert won(tmp_path / "results") == {0: 2}
    with pytest.raises(ArgumentError, match=r"no rows below .*evaluate; expected the `out` of"):
        publish(tmp_path / "nothing", tmp_path / "results")


def test_curves_are_means_over_many_steps(tmp_path: Path) -> None:
    out = tmp_path / "out"
    measured(out, 0, 2)
    folder = out / "policies" / "lift_barrier" / "full" / "separate_local" / "fast-50-0" / "agent1"
    folder.mkdir(parents=True)
    steps = [f"{step},{step / 20:g},{step / 10:g}" for step in range(20, 281, 20)]
    (folder / "curves.csv").write_text("\n".join(["step,loss,core_s", *steps]))
    publish(out, tmp_path / "results")
    averaged = {"step": [200, 280], "loss": [5.5, 12.5], "core_s": [20, 28]}
    assert published(tmp_path / "results").curves == {0: {"agent1": averaged}}


@pytest.mark.parametrize(
    ("of", "files"),
    [("expert", ["lift_barrier.tsv"]), ("ablation", ["lift_barrier/full.tsv", "lift_barrier/logical.tsv"])],
)
def test_rows_of_demonstrations_are_published_as_they_are(tmp_path: Path, of: str, files: list[str]) -> None:
    for kind in ("full", "logical"):
        for row in generation("lift_barrier", kind, 3, 2):
            append_row(tmp_path / f"out/results/generate/lift_barrier/{kind}.jsonl", row)
    runpy.run_path(str(SCRIPT))["publish_demonstrations"](tmp_path / "out", tmp_path / "results", of)
    assert sorted(tmp_path.glob("results/**/*.tsv")) == [tmp_path / "results" / of / name for name in files]
    for name in files:
        kind = "logical" if "logical" in name else "full"
        rows = read_rows(tmp_path / f"out/results/generate/lift_barrier/{kind}.jsonl", GenerationRow)
        assert read_rows(tmp_path / "results" / of / name, GenerationRow) == rows and len(rows) == 5
