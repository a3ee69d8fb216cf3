"""Checks in signal temporal logic (STL): formulas, and their robustness on an execution, by rtamt.

A check becomes formulas over named signals of an execution: one sample for each control step that the monitor
has judged, at 20 Hz. Discrete time is exact, because the monitor judges these steps and nothing between them.
The text is in the specification language of rtamt. A formula has one unit, so that its robustness is a margin
in that unit; a check with numbers in several units, or with unrelated margins, has several formulas, and
holds when all of them do.

A condition ("while Agent_1 holds lid") is MAX_MARGIN where it is true and -MAX_MARGIN where not: more than
any margin, so the robustness of `always (condition implies margin)` is the least margin, or MAX_MARGIN where
nothing was judged. Every check has an STL form (`Check.stl`). rtamt is an optional dependency, imported at
the first evaluation.
"""

import io
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.plan import Plan
from rf_exp.errors import ArgumentError
from rf_exp.types import CONTROL_DT_S, Scene

if TYPE_CHECKING:
    from rf_exp.constraints.check import Check, Evidence

MAX_MARGIN = 1e9  # in any unit, larger than any margin
TIME_TOLERANCE_S = 1e-9  # tolerance of the checks of time
Comparison = Literal["<=", ">=", ">"]


class Execution:
    """The control steps of a plan that its monitor has judged."""

    def __init__(self, plan: Plan, scenes: Sequence[Scene]) -> None:
        """`scenes` (T,): as measured after each control step, from the first one of the plan on."""
        self.plan, self.scenes = plan, tuple(scenes)
        self._evidence: dict[Check, list[Evidence | None]] = {}
        self._values: dict[str, NDArray[np.float64]] = {}

    def __len__(self) -> int:
        return len(self.scenes)

    @property
    def clock_s(self) -> NDArray[np.float64]:
        """(T,) time since the start of the plan."""
        return np.arange(1, len(self) + 1, dtype=float) * CONTROL_DT_S

    def positions(self, agent: int) -> NDArray[np.int64]:
        """(T,) path position commanded to the agent in each control step."""
        return self.plan.positions(agent)[1 : len(self) + 1]

    def measured(self, check: "Check") -> "list[Evidence | None]":
        """(T,) evidence of the check on the measured state of each control step."""
        if check not in self._evidence:
            self._evidence[check] = [check.measured(scene, self.plan) for scene in self.scenes]
        return self._evidence[check]

    def values(self, signal: "Signal") -> NDArray[np.float64]:
        """(T,) values of a signal."""
        if signal.name not in self._values:
            self._values[signal.name] = signal.compute(self)
        return self._values[signal.name]


@dataclass(frozen=True)
class Signal:
    """A number at every control step of an execution. Signals of the same name are the same."""

    name: str  # an identifier
    unit: str  # empty for a condition, which is MAX_MARGIN where it is true and -MAX_MARGIN where not
    description: str  # how it is computed from the recording
    compute: Callable[[Execution], NDArray[np.float64]]  # (T,)


@dataclass(frozen=True)
class Formula:
    """One formula, to be evaluated at the first control step of an execution."""

    text: str
    unit: str  # of its robustness
    strict: bool = False  # robustness 0 is a violation


@dataclass(frozen=True)
class Specification:
    """A check in STL. Without formulas, `no_formulas_reason` says why it can have none."""

    formulas: tuple[Formula, ...] = ()
    signals: tuple[Signal, ...] = ()
    measured: bool = True  # False: the check judges the plan alone, so its signals are of the commands
    no_formulas_reason: str = ""


def always(margins: Sequence[str], unit: str, *conditions: Signal, strict: bool = False) -> Formula:
    """Formula that all margins, such as `distance_1_2 >= 0.03`, hold whenever the conditions do."""
    body = _conjunction(margins)
    if conditions:
        body = f"({_conjunction([f'{condition.name} >= 0' for condition in conditions])}) implies ({body})"
    return Formula(f"always({body})", unit, strict)


def _conjunction(parts: Sequence[str]) -> str:
    return " and ".join(f"({part})" for part in parts) if len(parts) > 1 else parts[0]


def condition_values(holds: Iterable[bool] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """(T,) values of a condition: MAX_MARGIN or -MAX_MARGIN."""
    return np.where(np.asarray(tuple(holds), dtype=bool), MAX_MARGIN, -MAX_MARGIN)


def identifier(*parts: object) -> str:
    """An identifier, e.g. `distance_1_2`; in it p is a decimal point and n a minus sign."""
    text = "_".join(f"{part:g}" if isinstance(part, float) else str(part) for part in parts)
    return re.sub(r"\W", "_", text.replace(".", "p").replace("-", "n"))


@dataclass(frozen=True)
class FormulaRobustness:
    """A formula with its robustness on an execution."""

    formula: Formula
    robustness: float  # in the formula's unit; MAX_MARGIN: nothing was judged

    @property
    def holds(self) -> bool:
        return self.robustness > 0 if self.formula.strict else self.robustness >= 0

    @property
    def applies(self) -> bool:
        return abs(self.robustness) < MAX_MARGIN


def evaluate_check(execution: Execution, check: "Check") -> tuple[FormulaRobustness, ...]:
    """Robustness of each formula of a check. Raises ArgumentError where rtamt is not installed."""
    form = check.stl(execution.plan.task)
    if not len(execution):
        return tuple(FormulaRobustness(formula, MAX_MARGIN) for formula in form.formulas)
    values = {signal.name: execution.values(signal).tolist() for signal in form.signals}
    return tuple(
        FormulaRobustness(formula, evaluate_formula(formula.text, values)) for formula in form.formulas
    )


def rtamt_installed() -> bool:
    return find_spec("rtamt") is not None


def evaluate_formula(text: str, signals: dict[str, list[float]]) -> float:
    """Robustness of a formula for signals (T,), T > 0, at their first sample, by rtamt."""
    if not rtamt_installed():
        raise ArgumentError(
            "robustness needs rtamt, which is not installed; pip install 'rf_exp[stl]' brings it"
        )
    import rtamt

    specification = rtamt.STLDiscreteTimeSpecification()
    for name in ("robustness", *signals):
        specification.declare_var(name, "float")
    specification.spec = f"robustness = {text}"
    with redirect_stdout(io.StringIO()):  # its parser reports another version of antlr
        specification.parse()
    steps = max(map(len, signals.values()))
    if steps == 1:  # rtamt needs two samples; repeating one does not change an invariant
        signals, steps = {name: values * 2 for name, values in signals.items()}, 2
    return specification.evaluate({"time": list(range(steps)), **signals})[0][1]


def monitor_verdict(execution: Execution, check: "Check") -> bool | None:
    """The verdict of the monitor on an execution, without STL.

    None: the check judges the plan alone, and its violation is after the end of the execution.
    """
    if check.stl(execution.plan.task).measured:
        return all(evidence is None or evidence.ok for evidence in execution.measured(check))
    evidence = check.planned(execution.plan)
    end_s = execution.plan.begins_s + len(execution) * CONTROL_DT_S
    return None if not evidence.ok and evidence.time_s > end_s + TIME_TOLERANCE_S else evidence.ok


def signals(execution: Execution, checks: "Sequence[Check]") -> tuple[Signal, ...]:
    """The signals of several checks, each once."""
    forms = (check.stl(execution.plan.task) for check in checks)
    return tuple({signal.name: signal for form in forms for signal in form.signals}.values())
