"""The section of the report on demonstrations: by how much their plans kept what was asked of them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rf_exp.ablation.page import Section, Texts
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import title_of
from rf_exp.artifacts import read_json
from rf_exp.errors import StageError

HEADING = ("Task", "Scene", "Constraints judged", "Least robustness", "Of the formula")
LEAD = (
    "What was executed, judged in signal temporal logic: the margin left where it was least, for each unit. "
    "Below zero it is a violation."
)
MISSING = "needs rtamt: pip install 'rf_exp[stl]', and make the demonstration again"


def robustness(out: Path, suite: Suite) -> Section:
    """Of every demonstration below `out/demonstrations`; empty where there is none.

    Read from what lies beside its page, so nothing is judged again, and rtamt is not needed here.
    """
    lines: list[tuple[str, ...]] = []
    notes = []
    for path in sorted((out / "demonstrations").glob("*.json")):
        task, _, scene = path.stem.rpartition("-")
        try:
            plans = read_json(path, "make the demonstration again")["stl"]
            found = list(_least([check for plan in plans for check in plan["checks"]]))
        except (StageError, KeyError, TypeError, OSError) as error:
            notes.append(f"{path}: cannot be read: {error!r}")
            continue
        lines += [(title_of(task, suite), scene, *each) for each in found]
    return Section(
        "robustness",
        "Robustness of demonstrations",
        lead=LEAD if lines else "",
        texts=Texts(HEADING, tuple(lines)) if lines else None,
        notes=tuple(notes),
    )


def _least(checks: list[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """For each unit how many constraints were judged, the least robustness, and the formula that has it."""
    formulas = [(check["check"], formula) for check in checks for formula in check["formulas"]]
    if formulas and all(formula["holds"] is None for _, formula in formulas):
        yield "none", MISSING, ""
        return
    judged = [(name, formula) for name, formula in formulas if formula["robustness"] is not None]
    for unit in sorted({formula["unit"] for _, formula in judged}):
        of_unit = [(name, formula) for name, formula in judged if formula["unit"] == unit]
        name, least = min(of_unit, key=lambda each: each[1]["robustness"])
        constraints = len({name for name, _ in of_unit})
        yield str(constraints), f"{least['robustness']:.3g} {unit}", f"{name}: {least['stl']}"
