"""Temporal checks in signal temporal logic."""

from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.checks.temporal import Deadline, Sequential, ShareSpace, Simultaneous, times_s
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import (
    CLOCK_S,
    VOID,
    Specification,
    always,
    condition,
    named,
    of_schedule,
    step_parts,
    stl_of,
)
from rf_exp.statements import Step
from rf_exp.tasks import Task


@stl_of.register
def _(check: Sequential, task: Task) -> Specification:
    ended, begun = _since(check.first, "end"), _begun(check.then)
    return of_schedule((always([f"{ended.name} >= {check.wait_s - CLOCK_S!r}"], "s", begun),), ended, begun)


@stl_of.register
def _(check: Simultaneous, task: Task) -> Specification:
    begins = [(_since(step, "begin"), _begun(step)) for step in check.steps]
    formulas = tuple(
        always([f"abs({a.name} - {b.name}) <= {check.within_s + CLOCK_S!r}"], "s", a_begun, b_begun)
        for (a, a_begun), (b, b_begun) in combinations(begins, 2)
    )
    return of_schedule(formulas, *(signal for pair in begins for signal in pair))


@stl_of.register
def _(check: Deadline, task: Task) -> Specification:
    clock = Signal("clock", "s", "since the plan began", lambda execution: execution.clock_s)

    def unfinished(execution: Execution) -> NDArray[np.float64]:
        times = times_s(check.step, execution.plan)
        return condition(execution.clock_s <= (-np.inf if times is None else times[1] + CLOCK_S))

    how = f"{check.step.text} is not over before this control step, by the commands given"
    open_ = Signal(named("unfinished", *step_parts(check.step)), "", how, unfinished)
    return of_schedule((always([f"clock <= {check.within_s + CLOCK_S!r}"], "s", open_),), clock, open_)


@stl_of.register
def _(check: ShareSpace, task: Task) -> Specification:
    return Specification(silent="it is a permission, which no execution can violate")


def _since(step: Step, edge: Literal["begin", "end"]) -> Signal:
    """Since when a part has made its first step or its last one."""

    def since(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        if times is None:  # what does not move is in nobody's way
            return np.full(len(execution), VOID)
        return execution.clock_s - times[edge == "end"]

    last = "last" if edge == "end" else "first"
    how = f"since the command of the {last} step of {step.text}; negative before it"
    return Signal(named("since", edge, *step_parts(step)), "s", how, since)


def _begun(step: Step) -> Signal:
    def begun(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        return condition(execution.clock_s >= (np.inf if times is None else times[0] - CLOCK_S))

    return Signal(
        named("begun", *step_parts(step)), "", f"{step.text} has begun, by the commands given", begun
    )
