"""The estimate before a long run: hours of the missing work, from measured costs."""

from pathlib import Path

import pytest

from rf_exp.ablation import append_row
from rf_exp.experiment import Experiment
from rf_exp.stages.preflight import estimated_time
from tests.ablation.conftest import evaluation
from tests.conftest import cell_of, experiment


def fast(out: Path, *overrides: str) -> Experiment:
    return experiment("recipe=fast", f"out={out}", *overrides)


def minutes(estimate: str) -> float:
    number, unit = estimate.removeprefix("about ").split()[:2]
    return float(number) * (60 if unit == "h" else 1)


@pytest.mark.slow
def test_the_time_of_the_published_table_is_estimated(tmp_path: Path) -> None:
    laptop = "profile=laptop", "task=all"
    one, two = (estimated_time(fast(tmp_path, *laptop, f"workers={n}")) for n in (1, 2))
    assert minutes(one) == pytest.approx(2 * minutes(two), rel=0.1)
    assert all(f"{stage} " in one for stage in ("generate", "train", "evaluate"))
    only = estimated_time(fast(tmp_path, *laptop, "workers=1", "stages=[evaluate]"))
    assert "generate" not in only and minutes(only) < minutes(one)


@pytest.mark.slow
def test_finished_work_is_not_counted(tmp_path: Path) -> None:
    overrides = "profile=laptop", "task=two_robots_stack_cube", "workers=1"
    whole = fast(tmp_path, *overrides)
    path = cell_of(whole).evaluation_path
    before = minutes(estimated_time(fast(tmp_path, *overrides, "stages=[evaluate]", "scenes=1000")))
    for row in evaluation("two_robots_stack_cube", "separate_local", 150, 100, 0, recipe="fast"):
        append_row(path, row)
    after = minutes(estimated_time(fast(tmp_path, *overrides, "stages=[evaluate]", "scenes=1000")))
    assert after == pytest.approx(0.9 * before, abs=1.1)


def test_rounds_of_correction_are_counted(tmp_path: Path) -> None:
    overrides = "profile=laptop", "task=two_robots_stack_cube", "workers=1", "stages=[train]"
    one, three = (minutes(estimated_time(fast(tmp_path, *overrides, f"dagger.rounds={n}"))) for n in (0, 2))
    assert three > 3 * one


@pytest.mark.parametrize("overrides", [("profile=paper", "recipe=paper"), ("stages=[report]",)])
def test_there_is_no_estimate_without_measured_costs_or_missing_work(
    tmp_path: Path, overrides: tuple[str, ...]
) -> None:
    assert estimated_time(fast(tmp_path, *overrides)) == ""


@pytest.mark.slow
def test_tasks_of_unknown_cost_are_named(tmp_path: Path) -> None:
    overrides = "profile=laptop", "workers=1"
    estimate = estimated_time(fast(tmp_path, *overrides, "task=all"))
    assert estimate.endswith(
        "without tasks of unknown cost: four_robots_stack_cube, place_cube_in_cup, strike_cube_hard, "
        "three_robots_place_shoes"
    )
    assert estimated_time(fast(tmp_path, *overrides, "task=place_cube_in_cup")) == ""
