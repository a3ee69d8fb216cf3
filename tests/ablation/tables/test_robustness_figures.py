"""The table of robustness: scenes with variation, in no other table, beside the same scenes without it."""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rf_exp.ablation import (
    EvaluationRow,
    Results,
    append_row,
    formats,
    paired,
    plots,
    publish,
    without_variation,
)
from rf_exp.ablation.tables import TABLES, build
from rf_exp.ablation.tables.table import Table
from rf_exp.findings import Account, Closest
from tests.ablation.conftest import evaluation, generation
from tests.ablation.tables.making import EMPTY, SUITE, at, evaluated


def rollouts(wins: int, losses: int, task: str = "lift_barrier", **more: Any) -> list[EvaluationRow]:
    return evaluation(task, "separate_local", 50, wins, losses, **{"recipe": "fast", **more})


def table(results: Results) -> Table:
    return build(results, SUITE)["robustness"]


def test_it_is_absent_without_variation(tmp_path: Path) -> None:
    assert "robustness" not in build(EMPTY, SUITE)
    assert "robustness" not in build(evaluated(rollouts(9, 1), rollouts(9, 1, recipe="fast+dagger1")), SUITE)
    append_row(
        tmp_path / "results/evaluate/lift_barrier/separate_local/full-fast-50.jsonl", rollouts(1, 0)[0]
    )
    publish(tmp_path, SUITE)
    assert not [*(tmp_path / "tables").glob("robustness.*")]


def test_the_report_stage_writes_it_like_the_others(tmp_path: Path) -> None:
    rows = tmp_path / "results/evaluate/lift_barrier/separate_local/full-fast-50-in-light.jsonl"
    append_row(rows, rollouts(1, 0, variation="light")[0])
    _, report = publish(tmp_path, SUITE)
    assert {path.name for path in (tmp_path / "tables").glob("robustness.*")} == {
        f"robustness.{suffix}" for suffix in ("md", "csv", "tex")
    }
    assert 'id="robustness"' in report.read_text("utf-8")


def test_each_variation_is_paired_with_the_same_scenes_without_it() -> None:
    found = table(
        evaluated(rollouts(8, 2), rollouts(5, 5, variation="light"), rollouts(1, 4, variation="cameras"))
    )
    assert [at(found, line.key, "scenes").value for line in found.lines] == ["none", "cameras", "light"]
    light, cameras = (f"lift_barrier-fast-50-{name}" for name in ("light", "cameras"))
    gap, expected = at(found, light, "difference"), paired([(k < 5, k < 8) for k in range(10)])
    assert (gap.value, gap.interval, gap.p, gap.n) == (
        pytest.approx(-0.3), expected.estimate.interval, expected.p, 10,
    )  # fmt: skip
    assert at(found, light, "strict").value == 0.5
    assert (at(found, cameras, "difference").value, at(found, cameras, "difference").n) == (-0.8, 5)
    assert at(found, "lift_barrier-fast-50-none", "difference").figure == "-"
    # Without common scenes there is no difference.
    without_common = table(evaluated(rollouts(8, 2, train_seed=1), rollouts(5, 5, variation="light")))
    assert at(without_common, light, "difference").missing
    # Scenes without a counterpart do not count, and a note says so.
    some = table(evaluated(rollouts(4, 0), rollouts(5, 5, variation="light")))
    assert at(some, light, "difference").n == 4
    assert "4 of 10 scenes were tried without variation too" in formats.markdown(some)


def test_variations_of_training_have_their_own_lines_and_full_comes_last() -> None:
    rows = [
        rollouts(9, 1, recipe=recipe, variation=name) for recipe in ("fast+full", "fast") for name in NAMES
    ]
    found = table(evaluated(*rows))
    cells = [
        [at(found, line.key, key).value for key in ("recipe", "learned_on", "scenes")] for line in found.lines
    ]
    order = ["none", "light", "table", "full"]
    assert cells == [["fast", learned, name] for learned in ("none", "full") for name in order]


NAMES = ("full", "light", "none", "table")


def test_no_other_table_counts_varied_scenes_or_policies_trained_in_them() -> None:
    """For every table, and every row that it could count."""
    usual = Results(
        tuple(generation("lift_barrier", "full", 6, 4)),
        (
            *rollouts(9, 1), *rollouts(8, 2, recipe="fast+dagger1"), *rollouts(7, 3, shield=True),
            *evaluation("lift_barrier", "foreign", 50, 6, 4, recipe="pi0+lora"),
        ),
    )  # fmt: skip
    more = Results(
        usual.generation
        + tuple(replace(row, variation="light") for row in generation("lift_barrier", "full", 0, 9)),
        usual.evaluation
        + tuple(replace(row, variation="light", success=False) for row in usual.evaluation)
        + tuple(rollouts(0, 9, recipe="fast+full"))
        + tuple(rollouts(0, 9, recipe="fast+full+dagger1")),
    )
    assert without_variation(more) == usual
    assert without_variation(usual) == usual
    clean, both = build(usual, SUITE), build(more, SUITE)
    assert {*both} - {*clean} == {"robustness"}
    assert {name: both[name] for name in TABLES} == clean


def test_a_foreign_policy_is_in_it_by_its_whole_name() -> None:
    rows = evaluation("lift_barrier", "foreign", 0, 6, 4, recipe="pi0+lora", variation="light")
    found = table(evaluated(rows))
    (line,) = found.lines
    assert [at(found, line.key, key).value for key in ("recipe", "learned_on")] == [
        "pi0+lora, foreign",
        "none",
    ]


def test_the_score_is_the_mean_of_known_scores() -> None:
    won, lost, ended = rollouts(1, 2, variation="light")
    lost = replace(lost, account=Account(closest=Closest(2, 4, 1.0, 0)))
    ended = replace(ended, account=Account(ended="took longer than 3600 s"))
    cell = at(table(evaluated([won, lost, ended])), "lift_barrier-fast-50-light", "score")
    assert (cell.value, cell.n) == (pytest.approx((1 + 2 / 5) / 2), 2)
    assert cell.note == "ended before they were judged, and without a score: 1"


def test_csv_has_the_numbers_as_they_are() -> None:
    found = table(evaluated(rollouts(8, 2), rollouts(5, 5, variation="light")))
    lines = csv.DictReader(io.StringIO(formats.tidy_csv(found)))
    cells = {(line["row"], line["column"]): line for line in lines}
    gap = cells["lift_barrier-fast-50-light", "difference"]
    assert (gap["unit"], float(gap["value"]), float(gap["p"])) == ("difference", pytest.approx(-0.3), 0.25)
    assert cells["lift_barrier-fast-50-light", "score"]["unit"] == "score"


@pytest.mark.slow
def test_a_map_shows_the_rate_of_every_task_and_factor() -> None:
    rows = [
        rollouts(9, 1),
        rollouts(3, 7, variation="light"),
        rollouts(6, 4, task="take_photo", variation="full"),
    ]
    rows += [rollouts(10, 0, recipe="fast+full", variation="full")]
    maps = dict(plots.success_maps(table(evaluated(*rows))))
    assert [*maps] == ["fast, learned on none, 50 demos", "fast, learned on full, 50 demos"]
    labels = re.findall(r"<text[^>]*>([^<]*)</text>", maps["fast, learned on none, 50 demos"])
    assert {"90", "30", "60", "Lift Barrier", "Take Photo", "none", "light", "full"} <= {*labels}
    assert "100" in maps["fast, learned on full, 50 demos"]
    assert "var(--ours)" in maps["fast, learned on full, 50 demos"]  # follows light and dark mode
