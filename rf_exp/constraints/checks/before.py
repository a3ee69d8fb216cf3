"""One part of a plan is over before another begins (paper: Trajectory Scheduling Validation)."""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.phases import about, begun, since, span, times_s
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import CLOCK_S, Specification, always, of_schedule
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName, Finding, names
from rf_exp.statements import Before, Step, agent_name
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_HZ


@dataclass(frozen=True)
class BeforeCheck(Check):
    """One part is over before another begins, with a pause of `wait_s` between. Values in seconds."""

    states, name, unit = Before, CheckName.SCHEDULING, "s"

    first: Step
    then: Step
    wait_s: float = 0.0
    text: str = ""

    @classmethod
    def compiled(cls, stated: Before, plans: Plans) -> "BeforeCheck":
        first, then = plans.step(stated.first), plans.step(stated.then)
        if first.agent == then.agent:
            raise plans.refused(f"needs two different agents; it names {agent_name(then.agent)}")
        return cls(first, then, stated.wait_s, stated.sentence)

    @property
    def agents(self) -> tuple[int, ...]:
        return self.first.agent, self.then.agent

    def __repr__(self) -> str:
        wait = f", wait {self.wait_s:g} s" if self.wait_s else ""
        return f"VS({names(self.agents)}, sequential{about(self.first)}{about(self.then)}{wait})"

    def rule(self, paths: Paths) -> "BeforeCheck":
        return self

    def demand(self, demands: Demands) -> None:
        """The cells of coordination diagrams that it forbids."""
        first = span(self.first, demands.trajectory(self.first.agent))
        then = span(self.then, demands.trajectory(self.then.agent))
        if first is None or then is None:
            return
        demands.before(self.first.agent, first[1], self.then.agent, then[0])
        if self.wait_s > 0:
            steps = int(np.ceil(self.wait_s * CONTROL_HZ - 1e-9))
            demands.delay(self.first.agent, first[1], self.then.agent, then[0], steps)

    def planned(self, plan: Plan) -> Evidence:
        first, then = times_s(self.first, plan), times_s(self.then, plan)
        if first is None or then is None:
            return self.idle(plan, self.wait_s)
        pause_s, begins_s = then[0] - first[1], plan.begins_s + then[0]
        ok, subgoals = pause_s >= self.wait_s - 1e-9, (self.first.text, self.then.text)
        return self.found(ok, Finding.TOO_SOON, pause_s, self.wait_s, begins_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        ended, began = since(self.first, "end"), begun(self.then)
        formula = always([f"{ended.name} >= {self.wait_s - CLOCK_S!r}"], "s", began)
        return of_schedule((formula,), ended, began)
