"""Success and length of the expert: correct denominators, versions kept apart, omissions noted."""

from dataclasses import replace

import pytest

from rf_exp.ablation import Results, formats, wilson
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.table import Rate
from tests.ablation.conftest import evaluation, generation
from tests.ablation.tables.making import SUITE, at, generated, made


def test_every_seed_counts_in_the_success_of_generation() -> None:
    table = made("ablation_success", generated(generation("lift_barrier", "logical", 6, 4, loose=2)))
    cell = at(table, "logical", "lift_barrier")
    assert (cell.value, cell.n, cell.paper) == (0.6, 10, 0.802)
    assert cell.success_paper == 0.8
    assert cell.interval == wilson(6, 10).interval


def test_only_successes_count_in_the_length() -> None:
    rows = generation("take_photo", "full", 3, 2, steps=200)
    cell = at(made("ablation_length", generated(rows)), "full", "take_photo")
    assert (cell.value, cell.n, cell.paper) == (201.0, 3, 204)
    half = 4.302653 / 3**0.5  # Student's t for two degrees of freedom, standard deviation 1
    assert cell.interval == pytest.approx((201 - half, 201 + half), abs=1e-5)
    none = at(
        made("ablation_length", generated(generation("take_photo", "full", 0, 4))), "full", "take_photo"
    )
    assert (none.value, none.placeholder, none.n) == (None, "no success", 0)
    assert none.note == "no success in 4 attempts"
    one = at(made("ablation_length", generated(generation("take_photo", "full", 1, 0))), "full", "take_photo")
    assert (one.value, one.interval) == (100.0, None)


def test_versions_never_share_a_cell() -> None:
    old = generation("lift_barrier", "full", 0, 10, version="9")
    new = generation("lift_barrier", "full", 4, 1, version="10")
    weaker = generation("lift_barrier", "logical", 1, 9, version="9")
    table = made("ablation_success", generated(old, new, weaker))
    cell = at(table, "full", "lift_barrier")
    assert (cell.value, cell.n, cell.version) == (0.8, 5, "10")
    assert cell.note == "criteria version 10; left out: 10 of version 9"
    assert "Lift Barrier: cells of criteria versions 10, 9 cannot be compared." in table.notes
    assert f"logical + spatial + temporal, Lift Barrier: {cell.note}." in formats.notes(table)


def test_another_brain_has_lines_of_its_own() -> None:
    rows = [
        generation("lift_barrier", "full", 5, 0),
        generation("lift_barrier", "full", 1, 4, brain="openai"),
    ]
    table = made("ablation_success", generated(*rows))
    assert at(table, "full", "lift_barrier").value == 1.0
    assert at(table, "full-openai", "lift_barrier").value == 0.2
    assert at(table, "full-openai", "lift_barrier").paper is None


def test_tasks_and_constraints_beyond_the_paper_s_are_shown() -> None:
    table = made("ablation_success", generated(generation("pour_tea", "no_logic", 1, 1)))
    cell = at(table, "no_logic", "pour_tea")
    assert (cell.value, cell.paper) == (0.5, None)
    assert [column.title for column in table.columns if column.kind is Rate] == [
        "Lift Barrier",
        "Three Robots Stack Cube",
        "Take Photo",
        "Pour Tea",
    ]


def test_the_gap_between_rows_comes_with_its_interval() -> None:
    rows = [generation("lift_barrier", "logical", 48, 32), generation("lift_barrier", "full", 56, 14)]
    (note,) = made("ablation_success", generated(*rows)).notes
    assert note == "Lift Barrier, against logical: full +20.0 points [+5.2, +33.4]."  # Newcombe's example


def test_disturbed_seeds_measure_no_expert_and_are_counted_apart() -> None:
    good = generation("lift_barrier", "full", 10, 0)
    bad = [replace(row, disturbance_rad=0.05) for row in generation("lift_barrier", "full", 1, 9)]
    trained = evaluation("take_photo", "separate_local", 150, 1, 1, recipe="fast", disturbance_rad=0.05)
    both, plain = (
        build(Results(generation=rows, evaluation=tuple(trained)), SUITE)
        for rows in ((*good, *bad), tuple(good))
    )
    assert both["ablation_success"].lines == plain["ablation_success"].lines
    cells = [at(both["tasks"], "lift_barrier", key).value for key in ("generated", "disturbed")]
    assert cells == [1.0, 0.1]
    assert "disturbed" not in {column.key for column in plain["tasks"].columns}
    note = "Recipe fast learns from demonstrations whose execution was disturbed, by 0.05 rad."
    for name, table in both.items():
        assert table.notes[-1] == note, name
        assert table.notes[-2].startswith("10 seeds of disturbed demonstrations do not measure the expert")
