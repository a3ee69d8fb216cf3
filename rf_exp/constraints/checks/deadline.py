from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import Evidence
from rf_exp.constraints.phases import TimedCheck, step_name_parts, step_suffix, steps_within, times_s
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import (
    TIME_TOLERANCE_S,
    Execution,
    Signal,
    Specification,
    always,
    condition_values,
    identifier,
)
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, agent_names
from rf_exp.statements import Deadline, Step
from rf_exp.tasks import Task


@dataclass(frozen=True)
class DeadlineCheck(TimedCheck):
    """A part ends in time. Value and bound in seconds since the start of the plan."""

    statement_type = Deadline

    step: Step
    within_s: float
    text: str = ""

    @property
    def steps(self) -> tuple[Step]:
        return (self.step,)

    def __repr__(self) -> str:
        return f"VS({agent_names(self.agents)}, deadline{step_suffix(self.step)}, {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        for agent, _, end in self.spans(demands):
            demands.deadlines.append((agent, end, steps_within(self.within_s)))

    def planned(self, plan: Plan) -> Evidence:
        times = times_s(self.step, plan)
        if times is None:
            return self.not_applicable(plan, self.within_s)
        ok, end_s, subgoals = times[1] <= self.within_s + 1e-9, plan.begins_s + times[1], (self.step.text,)
        return self.make_evidence(ok, Finding.TOO_LATE, times[1], self.within_s, end_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        def is_unfinished(execution: Execution) -> NDArray[np.float64]:
            _, ends_s = times_s(self.step, execution.plan) or (-np.inf, -np.inf)
            return condition_values(execution.clock_s <= ends_s + TIME_TOLERANCE_S)

        clock = Signal("clock", "s", "since the plan began", lambda execution: execution.clock_s)
        description = f"{self.step.text} is not over before this control step, by the commands given"
        unfinished = Signal(
            identifier("unfinished", *step_name_parts(self.step)), "", description, is_unfinished
        )
        formula = always([f"clock <= {self.within_s + TIME_TOLERANCE_S!r}"], "s", unfinished)
        return Specification((formula,), (clock, unfinished), measured=False)
