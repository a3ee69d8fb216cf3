"""The checks of a demonstration in signal temporal logic, with their robustness where rtamt is installed."""

from typing import Any

from rf_exp.constraints import Check, CheckedPlan
from rf_exp.constraints.stl import Execution, Formula, Robust, installed, judged, signals
from rf_exp.types import CONTROL_DT_S


def specified(checked: CheckedPlan, execution: Execution) -> dict[str, Any]:
    """The active checks of an executed plan, as plain JSON values: formulas, robustness, and signals (T,).

    Robustness is null where nothing was judged; `holds` as well where rtamt is not installed.
    """
    return {
        "begins_s": execution.plan.begins_s,
        "period_s": CONTROL_DT_S,
        "checks": [_check(execution, check) for check in checked.checks],
        "signals": {
            each.name: {"unit": each.unit, "how": each.how, "values": execution.values(each).tolist()}
            for each in signals(execution, checked.checks)
        },
    }


def _check(execution: Execution, check: Check) -> dict[str, Any]:
    form = check.stl(execution.plan.task)
    found = judged(execution, check) if installed() else (None,) * len(form.formulas)
    return {
        "check": repr(check),
        "text": check.text,
        "silent": form.silent,
        "formulas": [_formula(*each) for each in zip(form.formulas, found, strict=True)],
    }


def _formula(formula: Formula, found: Robust | None) -> dict[str, Any]:
    return {
        "stl": formula.text,
        "unit": formula.unit,
        "strict": formula.strict,
        "robustness": found.robustness if found is not None and found.judged else None,
        "holds": None if found is None else found.holds,
    }
