"""The checks as signal temporal logic (STL), for whoever has a tool for it.

A check becomes formulas over named signals of an execution: one sample for each control step that the monitor
has judged, at 20 Hz. Discrete time is exact, because the monitor judges these steps and nothing between them.
The text is in the specification language of rtamt. A formula speaks of one unit, so that its robustness is a
margin in that unit; a check with numbers in several units, or with margins that tell nothing of one another,
has several formulas, and holds when all of them do.

A condition ("while Agent_1 holds lid") is VOID where it is true and -VOID where not: more than any margin, so
the robustness of `always (condition implies margin)` is the least margin, or VOID where nothing was judged.
Every check has its form (`Check.stl`).
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Check
from rf_exp.constraints.stl.execution import Execution, Signal

VOID = 1e9  # in any unit: no margin is as large
CLOCK_S = 1e-9  # by which the checks of time let clocks differ
Comparison = Literal["<=", ">=", ">"]


@dataclass(frozen=True)
class Formula:
    """One formula, to be evaluated at the first control step of an execution."""

    text: str
    unit: str  # of its robustness
    strict: bool = False  # robustness 0 is a violation

    def holds(self, robustness: float) -> bool:
        """Whether it is satisfied with a robustness."""
        return robustness > 0 if self.strict else robustness >= 0


@dataclass(frozen=True)
class Specification:
    """A check in STL. Without formulas, `silent` says why it can have none."""

    formulas: tuple[Formula, ...] = ()
    signals: tuple[Signal, ...] = ()
    measured: bool = True  # False: the check judges the plan alone, so its signals are of what was commanded
    silent: str = ""


def always(margins: Sequence[str], unit: str, *when: Signal, strict: bool = False) -> Formula:
    """All margins, such as `distance_1_2 >= 0.03`, at every control step at which the conditions hold."""
    body = _all(margins)
    if when:
        body = f"({_all([f'{each.name} >= 0' for each in when])}) implies ({body})"
    return Formula(f"always({body})", unit, strict)


def bounded(
    check: Check,
    signal: tuple[str, str],
    comparison: Comparison,
    bound: float,
    when: tuple[str, str] = ("", ""),
) -> Specification:
    """The form of a check whose measured value has a bound, at every step or `when` it says something.

    `signal` and `when` are each a name and what it means.
    """

    def value(execution: Execution) -> NDArray[np.float64]:
        return np.array([0.0 if each is None else each.value for each in execution.measured(check)])

    def judged(execution: Execution) -> NDArray[np.float64]:
        return condition([each is not None for each in execution.measured(check)])

    name, how = signal
    gates = (Signal(when[0], "", when[1], judged),) if when[0] else ()
    number = Signal(name, check.unit, f"{how}; 0 at other steps" if gates else how, value)
    formula = always([f"{name} {comparison} {bound!r}"], check.unit, *gates, strict=comparison == ">")
    return Specification((formula,), (number, *gates))


def condition(holds: Iterable[bool] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """(T,) of a condition."""
    return np.where(np.asarray(tuple(holds), dtype=bool), VOID, -VOID)


def named(*parts: object) -> str:
    """An identifier, e.g. `distance_1_2`; in it p is a decimal point and n a minus sign."""
    text = "_".join(f"{part:g}" if isinstance(part, float) else str(part) for part in parts)
    return re.sub(r"\W", "_", text.replace(".", "p").replace("-", "n"))


def _all(parts: Sequence[str]) -> str:
    return " and ".join(f"({part})" for part in parts) if len(parts) > 1 else parts[0]


def of_schedule(formulas: tuple[Formula, ...], *signals: Signal) -> Specification:
    """What is judged by the commands given, not on the measured state."""
    return Specification(formulas, signals, measured=False)
