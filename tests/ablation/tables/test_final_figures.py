"""Final scenes, on which nothing was tuned: in a table of their own, beside the trial scenes."""

from dataclasses import replace

from rf_exp.ablation.tables import TABLES, build
from tests.ablation.conftest import evaluation
from tests.ablation.tables.making import SUITE, at, evaluated


def test_final_scenes_are_in_their_own_table_alone() -> None:
    trial = evaluation("lift_barrier", "separate_local", 150, 8, 2, recipe="fast")
    trial += evaluation("take_photo", "separate_local", 150, 1, 1, recipe="fast")
    final = [
        replace(row, scene_seed=row.scene_seed + 2_000_000)
        for row in evaluation("lift_barrier", "separate_local", 150, 3, 2, recipe="fast")
    ]
    varied = [replace(row, variation="light") for row in final]
    shielded = [replace(row, shield=True) for row in final]
    usual, both = build(evaluated(trial), SUITE), build(evaluated(trial, final, varied, shielded), SUITE)
    assert {*both} - {*usual} == {"final"} and "final" not in TABLES
    assert {name: both[name] for name in usual} == usual
    (line,) = both["final"].lines
    assert line.key == "lift_barrier-separate_local-full-150-fast"
    found = [
        (at(both["final"], line.key, key).value, at(both["final"], line.key, key).n)
        for key in ("trial", "final")
    ]
    assert found == [(0.8, 10), (0.6, 5)]
