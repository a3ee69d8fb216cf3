"""Several agents begin the same part together (paper: Trajectory Scheduling Validation)."""

from dataclasses import dataclass
from itertools import combinations

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.phases import about, begun, since, span, times_s
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import CLOCK_S, Specification, always, of_schedule
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName, Finding, names
from rf_exp.statements import TOGETHER_S, Step, Together
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_HZ


@dataclass(frozen=True)
class TogetherCheck(Check):
    """Several agents begin the same part at most `within_s` apart. Value and bound in seconds."""

    states, name, unit = Together, CheckName.SCHEDULING, "s"

    steps: tuple[Step, ...]
    within_s: float = TOGETHER_S
    text: str = ""

    @classmethod
    def compiled(cls, stated: Together, plans: Plans) -> "TogetherCheck":
        steps = tuple(plans.step(Step(agent, stated.verb, stated.object)) for agent in stated.agents)
        return cls(steps, stated.within_s, stated.sentence)

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(step.agent for step in self.steps)

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, simultaneous{about(self.steps[0])}, within {self.within_s:g} s)"

    def rule(self, paths: Paths) -> "TogetherCheck":
        return self

    def demand(self, demands: Demands) -> None:
        """The cells of coordination diagrams that it forbids."""
        spans = [(step.agent, span(step, demands.trajectory(step.agent))) for step in self.steps]
        within = int(min(self.within_s, 1e6) * CONTROL_HZ + 1e-9)
        for (a, span_a), (b, span_b) in combinations(spans, 2):
            if span_a is not None and span_b is not None:
                demands.together(a, span_a[0], b, span_b[0], within)

    def planned(self, plan: Plan) -> Evidence:
        begins = [times[0] for step in self.steps if (times := times_s(step, plan)) is not None]
        if len(begins) < 2:
            return self.idle(plan, self.within_s)
        apart_s, step = max(begins) - min(begins), self.steps[0]
        what = f"{step.verb} {step.object}" if step.verb else "their tasks"
        ok, last_s = apart_s <= self.within_s + 1e-9, plan.begins_s + max(begins)
        return self.found(ok, Finding.NOT_TOGETHER, apart_s, self.within_s, last_s, subgoals=(what,))

    def stl(self, task: Task) -> Specification:
        begins = [(since(step, "begin"), begun(step)) for step in self.steps]
        formulas = tuple(
            always([f"abs({a.name} - {b.name}) <= {self.within_s + CLOCK_S!r}"], "s", a_begun, b_begun)
            for (a, a_begun), (b, b_begun) in combinations(begins, 2)
        )
        return of_schedule(formulas, *(signal for pair in begins for signal in pair))
