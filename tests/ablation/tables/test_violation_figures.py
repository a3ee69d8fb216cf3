"""Violations are shown beside every success rate, of the same rows and in every format."""

import csv
import io

import pytest

from rf_exp.ablation import Results, formats, paper, wilson
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.table import Violations
from tests.ablation.conftest import BUDGET, generation
from tests.ablation.tables.making import (
    NAMES,
    SUITE,
    at,
    by_hand,
    counted,
    followers,
    generated,
    html,
    made,
    shown,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_violations_of_the_same_rows_are_beside_every_success_rate(name: str) -> None:
    made_rows, rolled = counted()
    table = made(name, Results(tuple(made_rows), tuple(rolled)))
    beside = list(followers(table))
    assert bool(beside) == (name not in ("comparison", "recipes"))  # text only; a single recipe
    for column, after in beside:
        assert (after.key, after.title, after.kind) == (f"{column.key}_violations", "violations", Violations)
        for line in (line for line in table.lines if line.title != "Average"):
            expected = by_hand(name, line.key, column.key)
            cell, figure = at(table, line.key, after.key), at(table, line.key, column.key)
            assert expected and cell.n == figure.n == len(expected)
            assert cell.value == sum(n > 0 for n in expected) / len(expected), (line.key, column.key)
            assert cell.mean_violations == pytest.approx(sum(expected) / len(expected))
            assert cell.interval == wilson(sum(n > 0 for n in expected), len(expected)).interval
            assert (type(cell), cell.version) == (Violations, "2")
    averages = [line for line in table.lines if line.title == "Average"]
    assert len(averages) == (4 if name == "benchmark" else 0)
    for line in averages:
        level = [task for task, agents in paper().levels.items() if line.key == f"average_{agents}"]
        for column, after in beside:
            each = [by_hand(name, task, column.key) for task in level]
            shares = [sum(n > 0 for n in numbers) / len(numbers) for numbers in each]
            cell = at(table, line.key, after.key)
            assert cell.value == pytest.approx(sum(shares) / len(level))
            assert cell.mean_violations == pytest.approx(sum(map(sum, each)) / 5 / len(level))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_format_shows_the_violations(name: str) -> None:
    made_rows, rolled = counted()
    table = made(name, Results(tuple(made_rows), tuple(rolled)))
    texts = (formats.markdown(table), formats.latex(table), html(table), shown(table))
    for _, after in followers(table):
        for line in table.lines:
            cell = at(table, line.key, after.key)
            assert isinstance(cell.value, float)
            share, average = f"{100 * cell.value:.1f}", f"mean {cell.mean_violations:.2f}"
            assert all(share in text and average in text for text in texts)
    assert all(text.count("violations") >= len(list(followers(table))) for text in texts)
    rows = {(row["row"], row["column"]): row for row in csv.DictReader(io.StringIO(formats.tidy_csv(table)))}
    for column, after in followers(table):
        for line in table.lines:
            row, cell = rows[line.key, after.key], at(table, line.key, after.key)
            assert (row["unit"], row["status"], float(row["value"])) == ("violations", "measured", cell.value)
            assert float(row["mean_violations"]) == cell.mean_violations
            assert int(row["n"]) == int(rows[line.key, column.key]["n"])


def test_a_note_is_shown_once_and_violations_are_never_compared() -> None:
    rows = [
        generation("lift_barrier", "full", 5, 5, version="2", violations=(1, 0)),
        generation("lift_barrier", "full", 5, 5, version="1"),
        generation("lift_barrier", "logical", 5, 5, version="2", violations=(3,)),
        generation("take_photo", "full", 1, 1, version="1"),
    ]
    table = made("ablation_success", generated(*rows))
    gap, clean, left_out = formats.notes(table)
    assert gap.startswith("Lift Barrier, against logical: full +0.0 points")
    assert clean.startswith("Lift Barrier without a violation, against logical: full +20.0 points")
    assert left_out == (
        "logical + spatial + temporal, Lift Barrier: criteria version 2; left out: 10 of version 1."
    )


def test_success_without_a_violation_is_counted_beside_success() -> None:
    """Two of four successes needed no repair; every format shows it in bold, like success and violations."""
    rows = [
        *generation("lift_barrier", "logical", 4, 6, violations=(0, 1, 2, 0, BUDGET)),
        *generation("lift_barrier", "full", 9, 1, violations=(0,) * 9 + (BUDGET,)),
    ]
    table = made("ablation_success", generated(rows))
    cell = at(table, "logical", "lift_barrier")
    assert (cell.value, cell.clean) == (0.4, wilson(2, 10))
    text, tex, drawn = formats.markdown(table), formats.latex(table), html(table)
    for logical in ("**40.0 %**, ", "without a violation **20.0 %** [5.7, 51.0]", "| **60.0 %**, "):
        assert logical in text
    assert "without a violation **90.0 %** [59.6, 98.2]" in text  # also where no success needed a repair
    for value in (
        r"\textbf{40.0 \%}, ",
        r"without a violation \textbf{20.0 \%} [5.7",
        r"& \textbf{60.0 \%}, ",
    ):
        assert value in tex
    assert "<b>40.0 %</b>" in drawn
    assert "<b>20.0 %</b> <span>without a violation</span><small>[5.7, 51.0]" in drawn
    assert "<b>60.0 %</b> <span>violations</span>" in drawn
    styled = shown(table, styled=True)
    assert all(f"\x1b[1m{value}" in styled for value in ("40.0 %", "20.0 %", "60.0 %"))
    (line,) = [
        row
        for row in csv.DictReader(io.StringIO(formats.tidy_csv(table)))
        if (row["row"], row["column"]) == ("logical", "lift_barrier")
    ]
    assert (float(line["clean"]), float(line["clean_low"])) == (0.2, wilson(2, 10).low)


def test_without_a_success_there_are_no_violations_on_the_way_to_one() -> None:
    rows = generation("take_photo", "full", 0, 4, violations=(BUDGET,))
    built = build(generated(rows), SUITE)
    assert at(built["ablation_length"], "full", "take_photo_violations").placeholder == "no success"
    cell = at(built["ablation_success"], "full", "take_photo_violations")
    assert (cell.value, cell.mean_violations) == (1.0, BUDGET)
