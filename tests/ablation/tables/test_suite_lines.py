"""The tasks of the suite, in the words of their files, and custom tasks."""

import pytest
import yaml

from rf_exp.ablation import configured, paper
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.inputs import Suite, TaskFacts
from rf_exp.errors import ArgumentError
from rf_exp.tasks import CONFIGURED
from tests.ablation.tables.making import EMPTY, SUITE, at, made


def test_every_configured_task_is_shown_in_the_words_of_its_file() -> None:
    table = build(EMPTY, configured())["tasks"]
    paths = sorted(CONFIGURED.glob("*.yaml"))
    assert paths and {path.stem for path in paths} == set(configured())
    for path in paths:
        node = yaml.safe_load(path.read_text("utf-8"))[path.stem]
        words = (len(node["robots"]), node["title"], node["description"], node["target_condition"])
        columns = ("agents", "description", "condition")
        agents, description, condition = (at(table, path.stem, column).value for column in columns)
        (title,) = (line.title for line in table.lines if line.key == path.stem)
        assert (int(str(agents)), title, description, condition) == words
        assert at(table, path.stem, "criteria").value


def test_a_custom_task_comes_after_the_paper_s() -> None:
    own = {**SUITE, "pour_tea": TaskFacts("Tea, Poured", 1, "An arm pours.", "The cup is full.", "3")}
    table = made("tasks", EMPTY, own)
    assert [line.key for line in table.lines] == [*paper().levels, "pour_tea"]
    cells = [at(table, "pour_tea", key).value for key in ("agents", "criteria", "description", "condition")]
    assert cells == ["1", "3", "An arm pours.", "The cup is full."]
    baseline = made("benchmark", EMPTY, own)
    assert (baseline.lines[-1].key, baseline.lines[-1].title) == ("pour_tea", "Tea, Poured")
    assert at(baseline, "average_1", "demos_150").paper == 0.49


def test_tasks_of_the_paper_that_are_not_configured_are_named() -> None:
    (note,) = made("tasks", EMPTY, {name: SUITE["lift_barrier"] for name in list(paper().levels)[:-1]}).notes
    assert note == "Tasks of the paper without a configuration: Long Pipeline Delivery."


def test_comparison_derives_its_own_row_from_the_tasks() -> None:
    def own_row(suite: Suite) -> list[object]:
        table = made("comparison", EMPTY, suite)
        return [at(table, "This suite", key).value for key in ("single", "multi", "level")]

    single_arm = TaskFacts("Pick", 1, "", "", "1")
    assert own_row(SUITE) == ["no", "yes", "Plan & Control"]
    assert own_row({"pick": single_arm}) == ["yes", "no", "Plan & Control"]
    assert own_row({**SUITE, "pick": single_arm}) == ["yes", "yes", "Plan & Control"]
    assert made("comparison", EMPTY).caption.endswith("2 tasks, by number of agents: 1 with 2, 1 with 4.")


def test_a_cell_that_does_not_exist_is_named() -> None:
    table = made("ablation_length", EMPTY)
    with pytest.raises(
        ArgumentError, match=r"unknown row of table ablation_length 'none'; available: full, log"
    ):
        table.cell("none", "lift_barrier")
    with pytest.raises(
        ArgumentError, match=r"unknown column of table ablation_length 'x'; available: lift_bar"
    ):
        table.cell("full", "x")
