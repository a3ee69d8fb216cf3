"""The report shows the margins by which demonstrations kept their constraints."""

import json
from pathlib import Path

import pytest

from rf_exp.ablation import configured
from rf_exp.ablation.report import margins
from rf_exp.datagen import Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.demonstration import demonstrate
from rf_exp.types import NO_PICTURES, ConstraintSet
from tests.ablation.conftest import write_report
from tests.conftest import read_task


def formula(unit: str, robustness: float | None, holds: bool | None = True) -> dict[str, object]:
    return {"stl": f"always(x_{unit} >= 0)", "unit": unit, "robustness": robustness, "holds": holds}


def write_formulas(out: Path, *checks: list[dict[str, object]]) -> None:
    """Writes the file beside the page of a demonstration, with these formulas of its checks."""
    entries = [{"check": f"Check({k})", "formulas": formulas} for k, formulas in enumerate(checks)]
    path = out / "demonstrations" / "lift_barrier-3.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        json.dumps({"certificate": {}, "stl": [{"checks": entries[:1]}, {"checks": entries[1:]}]})
    )


@pytest.mark.slow
def test_robustness_by_rtamt_is_in_the_report(tmp_path: Path) -> None:
    pytest.importorskip("rtamt")
    task = read_task("lift_barrier")
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    assert demonstrate(settings, NO_PICTURES, 0, tmp_path / "demonstrations").success
    plans = json.loads((tmp_path / "demonstrations" / "lift_barrier-0.json").read_text())["stl"]
    in_metres = [
        each["robustness"]
        for plan in plans
        for check in plan["checks"]
        for each in check["formulas"]
        if each["unit"] == "m" and each["robustness"] is not None
    ]
    found = margins(tmp_path, configured())
    rows = [row for row in found.rows if row[3].endswith(" m")]
    assert rows and rows[0][:2] == (task.title, "0") and rows[0][3] == f"{min(in_metres):.3g} m"
    text = write_report(tmp_path).read_text("utf-8")
    assert "Robustness of demonstrations" in text and rows[0][3] in text


def test_the_least_margin_of_each_unit_is_shown(tmp_path: Path) -> None:
    write_formulas(
        tmp_path, [formula("m", 0.2), formula("N", 3.0)], [formula("m", -0.0125, False)], [formula("m", None)]
    )
    found = margins(tmp_path, configured())
    assert [row[1:] for row in found.rows] == [
        ("3", "1", "3 N", "Check(0): always(x_N >= 0)"),
        ("3", "2", "-0.0125 m", "Check(1): always(x_m >= 0)"),
    ]


def test_without_rtamt_the_report_says_how_to_get_it(tmp_path: Path) -> None:
    write_formulas(tmp_path, [formula("m", None, None)])
    assert "pip install &#39;rf_exp[stl]&#39;" in write_report(tmp_path).read_text("utf-8")


def test_a_report_without_demonstrations_does_not_mention_robustness(tmp_path: Path) -> None:
    assert "obustness" not in write_report(tmp_path / "new").read_text("utf-8")


def test_a_damaged_file_is_reported(tmp_path: Path) -> None:
    write_formulas(tmp_path)
    (tmp_path / "demonstrations" / "lift_barrier-3.json").write_text("{")
    assert "lift_barrier-3.json: cannot be read" in margins(tmp_path, configured()).notes[0]
