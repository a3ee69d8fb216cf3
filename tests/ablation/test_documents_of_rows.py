"""The pages of policies and the tables of other documents agree with the rows in results/."""

import re
import runpy
from dataclasses import fields
from pathlib import Path
from statistics import fmean

import pytest

from rf_exp.ablation import PUBLISHED, EvaluationRow, GenerationRow, Results, load, read_rows
from rf_exp.command import CONF
from rf_exp.tasks import Task, Variation
from tests.ablation.conftest import evaluation

DOCS = Path(__file__).parents[2] / "docs"
DATA = re.compile(r"<dc:description>(.*?)</dc:description>", re.DOTALL)


@pytest.mark.slow
def test_the_pages_of_policies_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    script = runpy.run_path(str(DOCS / "policies.py"))
    rows = script["measured"]()
    for path, written in script["documents"](rows).items():
        assert path.read_text("utf-8") == written, "run: python docs/policies.py"
    # Another matplotlib renders lines slightly differently; the data that they show must be the same.
    panels = script["panels"](script["paper_table_cells"](script["rows_by_policy"](rows)))
    shown = runpy.run_path(str(DOCS / "figure.py"))["described"](panels)
    (described,) = DATA.findall((DOCS / "images" / "policies.svg").read_text("utf-8"))
    assert described == shown, "run: python docs/policies.py"


def test_the_pages_of_robustness_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    script = runpy.run_path(str(DOCS / "robustness.py"))
    for path, written in script["documents"](load(DOCS.parent)).items():
        assert path.read_text("utf-8") == written, "run: python docs/robustness.py"


def test_the_page_of_scaling_is_what_its_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    script = runpy.run_path(str(DOCS / "scaling.py"))
    cells = script["read"]()
    assert script["PAGE"].read_text("utf-8") == script["document"](cells), "run: python docs/scaling.py"
    alike = {
        (family, arms, 1): [{"motion_s": 0.1 * arms**2, "schedule_s": 0.0, "checks_s": 0.0}]
        for family in ("ring",)
        for arms in range(1, 6)
    }
    assert script["exponent"](alike, "ring", 1) == "2.00"


def test_the_page_of_robustness_lists_every_choice_and_the_rows_that_exist(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without rows, it says so."""
    monkeypatch.syspath_prepend(DOCS)
    script = runpy.run_path(str(DOCS / "robustness.py"))
    names = {path.stem for path in (CONF / "variation").glob("*.yaml")}
    assert set(script["variation_names"]()) == names
    assert all(line[2] == "nothing" for line in map(script["factor_line"], names) if line[0] == "`none`")
    keys = dict(script["keys"]())
    assert set(keys) == {f"`{each.name}`" for each in fields(Variation) if each.name != "name"}
    rows = evaluation("lift_barrier", "separate_local", 150, 2, 1, recipe="fast")
    rows += evaluation("lift_barrier", "separate_local", 150, 1, 2, recipe="fast", variation="light")

    def page_of(rows: list[EvaluationRow]) -> str:
        return script["documents"](Results(evaluation=tuple(rows)))[DOCS / "robustness.md"]

    assert "Nothing yet" in page_of(rows[:3])
    page = page_of(rows)
    assert "Nothing yet" not in page and "| Lift Barrier | fast | none | 150 | light | **33.3 %**" in page


@pytest.mark.slow
def test_tables_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    for path, written in runpy.run_path(str(DOCS / "tables.py"))["documents"]().items():
        assert path.read_text("utf-8") == written, "run: python docs/tables.py"


def test_a_task_lasts_twice_as_long_as_its_expert(task: Task) -> None:
    """`step_limit` is twice the mean length of successes in the published rows of the undisturbed expert."""
    rows = read_rows(DOCS.parent / "results" / "expert" / f"{task.name}{PUBLISHED}", GenerationRow)
    assert not any(row.disturbance_rad or row.delay_s for row in rows)
    wanted = round(2 * fmean(row.steps for row in rows if row.success))
    assert task.step_limit == wanted, f"write step_limit: {wanted} into conf/task/{task.name}.yaml"
