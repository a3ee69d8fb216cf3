"""What rtamt says of an execution: the robustness of the checks in signal temporal logic.

rtamt is an extra: nothing imports it before something is to be judged.
"""

import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec

from rf_exp.constraints.evidence import Check
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import CLOCK_S, VOID, Formula, Specification
from rf_exp.errors import ArgumentError
from rf_exp.types import CONTROL_DT_S


@dataclass(frozen=True)
class Robust:
    """A formula with what an execution makes of it."""

    formula: Formula
    robustness: float  # in the formula's unit; VOID: nothing was judged

    @property
    def holds(self) -> bool:
        return self.formula.holds(self.robustness)

    @property
    def judged(self) -> bool:
        return abs(self.robustness) < VOID


def installed() -> bool:
    """Whether rtamt is there."""
    return find_spec("rtamt") is not None


def judged(execution: Execution, check: Check) -> tuple[Robust, ...]:
    """Each formula of a check. Raises ArgumentError where rtamt is not installed."""
    form = check.stl(execution.plan.task)
    return tuple(Robust(formula, robustness(formula, form, execution)) for formula in form.formulas)


def robustness(formula: Formula, form: Specification, execution: Execution) -> float:
    """Of one formula, at the first control step."""
    if not len(execution):
        return VOID
    values = {signal.name: execution.values(signal).tolist() for signal in form.signals}
    return evaluated(formula.text, values)


def evaluated(text: str, signals: dict[str, list[float]]) -> float:
    """What rtamt gives for a formula and signals (T,), T > 0, at their first sample."""
    if not installed():
        raise ArgumentError(
            "robustness needs rtamt, which is not installed; pip install 'rf_exp[stl]' brings it"
        )
    import rtamt

    specification = rtamt.STLDiscreteTimeSpecification()
    for name in ("robustness", *signals):
        specification.declare_var(name, "float")
    specification.spec = f"robustness = {text}"
    with redirect_stdout(io.StringIO()):  # its parser says that it was made by another version of antlr
        specification.parse()
    steps = max(map(len, signals.values()))
    if steps == 1:  # rtamt asks for two samples; an invariant does not mind one twice
        signals, steps = {name: each * 2 for name, each in signals.items()}, 2
    return specification.evaluate({"time": list(range(steps)), **signals})[0][1]


def kept(execution: Execution, check: Check) -> bool | None:
    """The verdict of the monitor on an execution, without STL.

    None: the check judges the plan alone, and the violation that it found comes after the execution's end.
    """
    if check.stl(execution.plan.task).measured:
        return all(each is None or each.ok for each in execution.measured(check))
    evidence = check.planned(execution.plan)
    end_s = execution.plan.begins_s + len(execution) * CONTROL_DT_S
    return None if not evidence.ok and evidence.time_s > end_s + CLOCK_S else evidence.ok


def signals(execution: Execution, checks: Sequence[Check]) -> tuple[Signal, ...]:
    """The signals of several checks, each once."""
    found: dict[str, Signal] = {}
    for check in checks:
        for signal in check.stl(execution.plan.task).signals:
            found.setdefault(signal.name, signal)
    return tuple(found.values())
