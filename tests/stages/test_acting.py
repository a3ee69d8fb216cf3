"""For how long whoever acts may: one rule, of the task alone."""

import pytest

from rf_exp.stages import Cell
from rf_exp.stages.evaluation import policies_of
from tests.conftest import RECIPES, cell_of, experiment

FOREIGN = ("stages=[evaluate]", "foreign.name=mine", "foreign.factory=examples.foreign.hold:make")


@pytest.mark.slow
def test_a_scene_is_as_long_as_its_task_says_for_every_recipe_and_row_of_constraints() -> None:
    for recipe in RECIPES.values():
        asked = experiment("task=place_food", "constraints=all", f"policy={recipe}")
        (task,), (arch,) = asked.tasks, asked.archs
        limits = {policies_of(Cell(asked, task, row, arch)).step_limit for row in asked.constraint_sets}
        assert limits == {task.step_limit}, recipe


@pytest.mark.parametrize(("more", "limit"), [((), None), (("foreign.step_limit=7",), 7)])
def test_and_for_anybodys_policy_unless_it_is_said_otherwise(
    more: tuple[str, ...], limit: int | None
) -> None:
    asked = experiment("task=place_food", *FOREIGN, *more)
    assert policies_of(cell_of(asked)).step_limit == (limit or asked.tasks[0].step_limit)
