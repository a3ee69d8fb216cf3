"""Success of policies: by architecture, demonstrations and recipe; foreign policies separately."""

import pytest

from rf_exp.ablation import paper, wilson
from rf_exp.ablation.tables import build
from tests.ablation.conftest import evaluation
from tests.ablation.tables.making import SUITE, at, evaluated, made


def test_architectures_keep_numbers_of_demonstrations_apart() -> None:
    rows = [
        evaluation("lift_barrier", "shared_local", 50, 1, 9),
        evaluation("lift_barrier", "shared_local", 150, 5, 5),
        evaluation("lift_barrier", "my_arch", 150, 9, 1),
        evaluation("lift_barrier", "shared_local", 150, 0, 10, constraints="logical"),
    ]
    table = made("architectures", evaluated(*rows))
    assert at(table, "shared_local-50", "lift_barrier").value == 0.1
    assert at(table, "shared_local-150", "lift_barrier").value == 0.5
    assert at(table, "shared_local-150", "lift_barrier").paper == 0.04
    assert at(table, "my_arch-150", "lift_barrier").value == 0.9
    assert "10 rollouts of policies that learnt from logical data are not in this table." in table.notes


def test_privileged_state_of_policies_is_noted() -> None:
    local, privileged = (
        evaluation("take_photo", arch, 150, 9, 1) for arch in ("separate_local", "separate_coordinated")
    )
    for rows, count in ((local, 0), (local + privileged, 1)):
        notes = made("architectures", evaluated(rows)).notes
        assert sum("made in the true state of the scene" in note for note in notes) == count


def test_training_seeds_are_pooled_and_named() -> None:
    rows = [evaluation("place_food", "separate_local", 150, n, 10 - n, train_seed=n) for n in (2, 4, 6)]
    cell = at(made("benchmark", evaluated(*rows)), "place_food", "demos_150")
    assert (cell.value, cell.n, cell.note) == (0.4, 30, "3 training seeds together")


def test_an_average_waits_for_every_task_of_its_level() -> None:
    camera = evaluation("camera_alignment", "separate_local", 150, 4, 6)
    stack = evaluation("three_robots_stack_cube", "separate_local", 150, 2, 8)
    partly = at(made("benchmark", evaluated(camera)), "average_3", "demos_150")
    assert (partly.value, partly.note, partly.paper) == (None, "1 of 2 tasks measured", 0.205)
    whole = at(made("benchmark", evaluated(camera, stack)), "average_3", "demos_150")
    assert whole.value == pytest.approx(0.3)


def test_further_numbers_of_demonstrations_get_a_column() -> None:
    table = made("benchmark", evaluated(evaluation("lift_barrier", "separate_local", 20, 1, 1)))
    keys = [column.key for column in table.columns if column.compared]
    assert keys == [f"demos_{n}" for n in (20, 50, 100, 150)]
    assert at(table, "lift_barrier", "demos_20").value == 0.5


def test_recipes_have_lines_of_their_own_and_privileged_state_comes_last() -> None:
    of_paper = evaluation("lift_barrier", "separate_local", 150, 2, 4)
    ours = evaluation("lift_barrier", "separate_local", 150, 9, 1, recipe="fast", core_s=90.0)
    ours = [*ours, *evaluation("take_photo", "separate_local", 50, 1, 1, recipe="fast", core_s=60.0)]
    privileged = evaluation("lift_barrier", "separate_local", 150, 30, 0, recipe="state", observation="state")
    table = build(evaluated(of_paper, ours, privileged), SUITE)["benchmark"]
    lines = {line.key: line for line in table.lines}
    rates = {
        key: (lines[key].cells[1].value, at(table, key, "demos_150").value)
        for key in lines
        if key.startswith("lift_barrier")
    }
    assert rates == {
        "lift_barrier": ("fast", 0.9),
        "lift_barrier-paper": ("paper", 2 / 6),
        "lift_barrier-state": ("state", 1.0),
    }
    assert at(table, "lift_barrier", "core_minutes").value == "1.5"
    assert at(table, "lift_barrier-state", "core_minutes").value == ""
    assert (
        "Policies of recipe state are given the true poses of all things (privileged state)." in table.notes
    )
    other = evaluation("lift_barrier", "shared_local", 150, 1, 5)
    shown = made("architectures", evaluated(of_paper, other, ours, privileged))
    assert [(line.key, line.cells[1].value) for line in shown.lines if "separate_local" in line.key] == [
        ("separate_local-50", "fast"),
        ("separate_local-150", "fast"),
        ("separate_local-150-paper", "paper"),  # recipe state has no other architecture
    ]


def test_further_recipes_have_lines_where_they_have_rows() -> None:
    ours = evaluation("lift_barrier", "separate_local", 50, 9, 1, recipe="fast")
    other = evaluation("lift_barrier", "separate_local", 50, 5, 5, recipe="blind")
    table = made("benchmark", evaluated(ours, other))
    assert [line.key for line in table.lines if line.cells[1].value == "blind"] == ["lift_barrier-blind"]
    of_first = [line for line in table.lines if line.cells[1].value == "fast"]
    assert len(of_first) == len(paper().levels) + len(paper().averages)
    assert list(table.lines[: len(of_first)]) == of_first  # the paper's table is first, and complete


def test_recipes_are_compared_on_the_same_demonstrations() -> None:
    ours, other = (
        [
            *evaluation("place_food", "separate_local", 50, wins, 10 - wins, recipe=recipe),
            *evaluation("lift_barrier", "separate_local", 50, wins, 10 - wins, recipe=recipe, train_seed=1),
        ]
        for recipe, wins in (("fast", 9), ("blind", 4))
    )
    alone = evaluation("take_photo", "separate_local", 50, 1, 1, recipe="fast")
    elsewhere = evaluation("place_food", "separate_local", 150, 1, 1, recipe="fast")
    table = made("recipes", evaluated(other, ours, alone, elsewhere))
    assert [line.key for line in table.lines] == ["fast-50", "blind-50"]  # that of the profiles is first
    assert [column.key for column in table.columns if column.compared] == ["place_food", "lift_barrier"]
    assert at(table, "blind-50", "place_food").value == 0.4
    assert at(table, "blind-50", "place_food").paper == 0.05
    assert any(
        note.startswith("Place Food, 50 demos, against fast: blind -50.0 points") for note in table.notes
    )
    assert made("recipes", evaluated(ours)).lines == ()


def test_foreign_policies_count_in_no_other_table() -> None:
    """Even with more rows, and the name of a recipe of ours."""
    ours = evaluation("lift_barrier", "separate_local", 150, 9, 1, recipe="fast")
    others = evaluation("lift_barrier", "foreign", 0, 40, 10, recipe="fast", violations=(3,))
    alone, beside = build(evaluated(ours), SUITE), build(evaluated(ours, others), SUITE)
    assert {name: table for name, table in beside.items() if name != "foreign"} == {
        name: table for name, table in alone.items() if name != "foreign"
    }
    assert alone["foreign"].lines == ()
    (line,) = beside["foreign"].lines
    assert (line.key, line.title) == ("lift_barrier-fast-0", "Lift Barrier, fast")
    cell = at(beside["foreign"], line.key, "success")
    assert (cell.value, cell.interval) == (0.8, wilson(40, 50).interval)
    assert at(beside["foreign"], line.key, "success_violations").value == 1.0
