from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import Evidence, Plans
from rf_exp.constraints.phases import TimedCheck, about, begun, since
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import CLOCK_S, Specification, always
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, names
from rf_exp.statements import Before, Step, agent_name
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_HZ


@dataclass(frozen=True)
class BeforeCheck(TimedCheck):
    """One part ends before another begins, with a pause of `wait_s` between. Value and bound in seconds."""

    states = Before

    first: Step
    then: Step
    wait_s: float = 0.0
    text: str = ""

    @classmethod
    def compiled(cls, stated: Before, plans: Plans) -> "BeforeCheck":
        check = super().compiled(stated, plans)
        if check.first.agent == check.then.agent:
            raise plans.refused(f"needs two different agents; it names {agent_name(check.then.agent)}")
        return check

    @property
    def steps(self) -> tuple[Step, Step]:
        return self.first, self.then

    def __repr__(self) -> str:
        wait = f", wait {self.wait_s:g} s" if self.wait_s else ""
        return f"VS({names(self.agents)}, sequential{about(self.first)}{about(self.then)}{wait})"

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
            return self.idle(plan, self.wait_s)
        (_, end_s), (start_s, _) = times
        pause_s, begins_s = start_s - end_s, plan.begins_s + start_s
        ok, subgoals = pause_s >= self.wait_s - 1e-9, (self.first.text, self.then.text)
        return self.found(ok, Finding.TOO_SOON, pause_s, self.wait_s, begins_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        ended, began = since(self.first, "end"), begun(self.then)
        formula = always([f"{ended.name} >= {self.wait_s - CLOCK_S!r}"], "s", began)
        return Specification((formula,), (ended, began), measured=False)
