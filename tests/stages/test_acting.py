"""The step limit of rollouts: that of the task alone."""

import pytest

from rf_exp.stages import Cell
from rf_exp.stages.evaluation import policies_of
from tests.conftest import RECIPES, cell_of, experiment

FOREIGN = ("stages=[evaluate]", "foreign.name=mine", "foreign.factory=examples.foreign.hold:make")


@pytest.mark.slow
def test_the_step_limit_is_that_of_the_task_for_every_recipe_and_row() -> None:
    for recipe in RECIPES.values():
        configured = experiment("task=place_food", "constraints=all", f"policy={recipe}")
        (task,), (arch,) = configured.tasks, configured.archs
        limits = {
            policies_of(Cell(configured, task, row, arch)).step_limit for row in configured.constraint_sets
        }
        assert limits == {task.step_limit}, recipe


@pytest.mark.parametrize(("more", "limit"), [((), None), (("foreign.step_limit=7",), 7)])
def test_foreign_policies_have_it_too_unless_configured_otherwise(
    more: tuple[str, ...], limit: int | None
) -> None:
    configured = experiment("task=place_food", *FOREIGN, *more)
    assert policies_of(cell_of(configured)).step_limit == (limit or configured.tasks[0].step_limit)
