from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import Evidence
from rf_exp.constraints.phases import TimedCheck, about, step_parts, steps_within, times_s
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import CLOCK_S, Execution, Signal, Specification, always, condition, named
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, names
from rf_exp.statements import Deadline, Step
from rf_exp.tasks import Task


@dataclass(frozen=True)
class DeadlineCheck(TimedCheck):
    """A part ends in time. Value and bound in seconds since the start of the plan."""

    states = Deadline

    step: Step
    within_s: float
    text: str = ""

    @property
    def steps(self) -> tuple[Step]:
        return (self.step,)

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, deadline{about(self.step)}, {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        for agent, _, end in self.spans(demands):
            demands.deadlines.append((agent, end, steps_within(self.within_s)))

    def planned(self, plan: Plan) -> Evidence:
        times = times_s(self.step, plan)
        if times is None:
            return self.idle(plan, self.within_s)
        ok, end_s, subgoals = times[1] <= self.within_s + 1e-9, plan.begins_s + times[1], (self.step.text,)
        return self.found(ok, Finding.TOO_LATE, times[1], self.within_s, end_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        def goes_on(execution: Execution) -> NDArray[np.float64]:
            _, ends_s = times_s(self.step, execution.plan) or (-np.inf, -np.inf)
            return condition(execution.clock_s <= ends_s + CLOCK_S)

        clock = Signal("clock", "s", "since the plan began", lambda execution: execution.clock_s)
        how = f"{self.step.text} is not over before this control step, by the commands given"
        going_on = Signal(named("unfinished", *step_parts(self.step)), "", how, goes_on)
        formula = always([f"clock <= {self.within_s + CLOCK_S!r}"], "s", going_on)
        return Specification((formula,), (clock, going_on), measured=False)
