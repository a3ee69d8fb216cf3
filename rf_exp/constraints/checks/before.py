from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import Evidence, PlanContext
from rf_exp.constraints.phases import TimedCheck, begun_signal, elapsed_signal, step_suffix
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import TIME_TOLERANCE_S, Specification, always
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, agent_names
from rf_exp.statements import Before, Step, agent_name
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_HZ


@dataclass(frozen=True)
class BeforeCheck(TimedCheck):
    """One part ends before another begins, with a pause of `wait_s` between. Value and bound in seconds."""

    statement_type = Before

    first: Step
    then: Step
    wait_s: float = 0.0
    text: str = ""

    @classmethod
    def from_statement(cls, statement: Before, context: PlanContext) -> "BeforeCheck":
        check = super().from_statement(statement, context)
        if check.first.agent == check.then.agent:
            raise context.error(f"needs two different agents; it names {agent_name(check.then.agent)}")
        return check

    @property
    def steps(self) -> tuple[Step, Step]:
        return self.first, self.then

    def __repr__(self) -> str:
        wait = f", wait {self.wait_s:g} s" if self.wait_s else ""
        steps = step_suffix(self.first) + step_suffix(self.then)
        return f"VS({agent_names(self.agents)}, sequential{steps}{wait})"

    def demand(self, demands: Demands) -> None:
        spans = self.spans(demands)
        if len(spans) < 2:
            return
        (first, _, end), (then, start, _) = spans
        demands.before(first, end, then, start)
        if self.wait_s > 0:
            demands.delay(first, end, then, start, int(np.ceil(self.wait_s * CONTROL_HZ - 1e-9)))

    def planned(self, plan: Plan) -> Evidence:
        times = self.times_s(plan)
        if len(times) < 2:
            return self.not_applicable(plan, self.wait_s)
        (_, end_s), (start_s, _) = times
        pause_s, begins_s = start_s - end_s, plan.begins_s + start_s
        ok, subgoals = pause_s >= self.wait_s - 1e-9, (self.first.text, self.then.text)
        return self.make_evidence(ok, Finding.TOO_SOON, pause_s, self.wait_s, begins_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        ended, began = elapsed_signal(self.first, "end"), begun_signal(self.then)
        formula = always([f"{ended.name} >= {self.wait_s - TIME_TOLERANCE_S!r}"], "s", began)
        return Specification((formula,), (ended, began), measured=False)
