"""The pages of policies and the tables of other documents say what the rows in results/ say."""

import re
import runpy
from pathlib import Path
from statistics import fmean

import pytest

from rf_exp.ablation import PUBLISHED, GenerationRow, load, read_rows
from rf_exp.tasks import Task

DOCS = Path(__file__).parents[2] / "docs"
DATA = re.compile(r"<dc:description>(.*?)</dc:description>", re.DOTALL)


@pytest.mark.slow
def test_the_pages_of_policies_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    script, rows = runpy.run_path(str(DOCS / "policies.py")), load(DOCS.parent).evaluation
    for path, written in script["documents"](rows).items():
        assert path.read_text("utf-8") == written, "run: python docs/policies.py"
    # Lines are drawn a little otherwise by another matplotlib; what they show must be the same.
    panels = script["panels"](script["of_fast"](script["cells"](rows)))
    shown = runpy.run_path(str(DOCS / "figure.py"))["described"](panels)
    (told,) = DATA.findall((DOCS / "images" / "policies.svg").read_text("utf-8"))
    assert told == shown, "run: python docs/policies.py"


@pytest.mark.slow
def test_tables_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    for path, written in runpy.run_path(str(DOCS / "tables.py"))["documents"]().items():
        assert path.read_text("utf-8") == written, "run: python docs/tables.py"


def test_a_task_lasts_twice_as_long_as_its_expert(task: Task) -> None:
    """A law: `step_limit` is what the published rows of the undisturbed expert say."""
    rows = read_rows(DOCS.parent / "results" / "expert" / f"{task.name}{PUBLISHED}", GenerationRow)
    assert not any(row.disturbance_rad or row.delay_s for row in rows)
    wanted = round(2 * fmean(row.steps for row in rows if row.success))
    assert task.step_limit == wanted, f"write step_limit: {wanted} into conf/task/{task.name}.yaml"
