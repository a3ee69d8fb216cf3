"""The end of the output of a run: success rates of policies, a film, and the next command."""

from dataclasses import replace
from pathlib import Path

from rf_exp.ablation import FILM, append_row, rollout_file
from rf_exp.stages.reporting import next_command, success_lines
from tests.ablation.conftest import evaluation
from tests.conftest import cell_of, experiment


def test_success_is_shown_with_its_interval_and_one_film(tmp_path: Path) -> None:
    configured = replace(experiment("demos=50", "scenes=4"), out=tmp_path)
    assert [*success_lines(configured)] == []
    cell = cell_of(configured)
    rows = evaluation("lift_barrier", "separate_local", 50, 3, 1, recipe="test", version=cell.task.version)
    for row in rows:
        append_row(cell.evaluation_path, row)
    place = "lift_barrier/full/separate_local"
    line = f"{place}: 3 of 4 scenes succeeded (95 % interval 30 to 95 %)"
    assert [*success_lines(configured)] == [line]
    films = {row.success: tmp_path / rollout_file(row, FILM) for row in rows}
    films[True].parent.mkdir(parents=True)
    films[False].touch()
    assert [*success_lines(configured)] == [line, f"film: {films[False]}"]
    films[True].touch()
    assert [*success_lines(configured)] == [line, f"film: {films[True]}"]
    assert [*success_lines(replace(configured, first_scene=3_000_000))] == []


def test_the_next_task_is_named_and_after_several_the_benchmark() -> None:
    assert next_command(experiment("task=lift_barrier")).endswith(" task=two_robots_stack_cube")
    assert next_command(experiment("task=long_pipeline_delivery")).endswith(" task=pick_meat")
    assert next_command(experiment("task=ring")).endswith(" task=pick_meat")
    assert next_command(experiment("task=all")).endswith(" experiment=benchmark")
