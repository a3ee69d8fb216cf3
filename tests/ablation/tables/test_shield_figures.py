"""Rollouts with a shield: compared over the same scenes, in a table of their own."""

import pytest

from rf_exp.ablation import Results
from rf_exp.ablation.tables.table import Violations
from tests.ablation.conftest import evaluation
from tests.ablation.tables.making import at, evaluated, made


def shielded_rows() -> Results:
    """15 scenes of one policy, 10 of them also with a shield, and a policy with shielded scenes only."""
    without = evaluation("lift_barrier", "separate_local", 150, 6, 9, violations=(4, 0), contacts=2)
    with_it = evaluation("lift_barrier", "separate_local", 150, 8, 2, shield=True, interventions=7)
    alone = evaluation("take_photo", "shared_local", 50, 1, 1, shield=True)
    return evaluated(without, with_it, alone)


def test_a_shield_is_compared_over_the_same_scenes() -> None:
    table = made("shield", shielded_rows())
    assert [line.key for line in table.lines] == [
        "lift_barrier-separate_local-150-paper",
        "take_photo-shared_local-50-paper",
    ]
    line = table.lines[0].key
    for column, value, many in (
        ("without", 0.6, None),
        ("with", 0.8, None),
        ("without_violations", 0.5, 2.0),
        ("with_violations", 0.0, 0.0),
        ("without_contacts", 0.4, 0.8),
        ("with_contacts", 0.0, 0.0),
        ("interventions", 1.0, 7.0),
    ):
        cell = at(table, line, column)
        assert (cell.value, cell.n) == (value, 10), column
        assert cell.mean_violations == many if isinstance(cell, Violations) else many is None
        assert cell.interval is not None
    gap = "Lift Barrier, separate_local, 150 demos, paper, against without: with +20.0 points ["
    assert any(note.startswith(gap) for note in table.notes)
    only = table.lines[1].key
    assert (at(table, only, "without").value, at(table, only, "with").value) == (None, 0.5)


def test_without_a_shielded_rollout_the_table_is_empty() -> None:
    assert made("shield", evaluated(evaluation("lift_barrier", "separate_local", 150, 6, 9))).lines == ()


@pytest.mark.parametrize("name", ["tasks", "benchmark", "architectures"])
def test_other_tables_leave_shielded_rollouts_out_and_say_so(name: str) -> None:
    results = shielded_rows()
    rest = Results(evaluation=tuple(row for row in results.evaluation if not row.shield))
    table, plain = made(name, results), made(name, rest)
    assert table.lines == plain.lines
    note = "12 shielded rollouts are in a table of their own, shield."
    assert note in table.notes and note not in plain.notes
