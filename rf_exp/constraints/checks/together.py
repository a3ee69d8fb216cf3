from dataclasses import dataclass
from itertools import combinations

from rf_exp.constraints.check import Evidence, Plans
from rf_exp.constraints.phases import TimedCheck, about, begun, since, steps_within
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import CLOCK_S, Specification, always
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, names
from rf_exp.statements import TOGETHER_S, Step, Together
from rf_exp.tasks import Task


@dataclass(frozen=True)
class TogetherCheck(TimedCheck):
    """Several agents begin the same part at most `within_s` apart. Value and bound in seconds."""

    states = Together

    steps: tuple[Step, ...]
    within_s: float = TOGETHER_S
    text: str = ""

    @classmethod
    def compiled(cls, stated: Together, plans: Plans) -> "TogetherCheck":
        steps = tuple(plans.step(Step(agent, stated.verb, stated.object)) for agent in stated.agents)
        return cls(steps, stated.within_s, stated.sentence)

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, simultaneous{about(self.steps[0])}, within {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        for (a, start_a, _), (b, start_b, _) in combinations(self.spans(demands), 2):
            demands.together(a, start_a, b, start_b, steps_within(self.within_s))

    def planned(self, plan: Plan) -> Evidence:
        begins = [begins_s for begins_s, _ in self.times_s(plan)]
        if len(begins) < 2:
            return self.idle(plan, self.within_s)
        apart_s, subgoals = max(begins) - min(begins), (self.steps[0].does("their tasks"),)
        ok, last_s = apart_s <= self.within_s + 1e-9, plan.begins_s + max(begins)
        return self.found(ok, Finding.NOT_TOGETHER, apart_s, self.within_s, last_s, subgoals=subgoals)

    def stl(self, task: Task) -> Specification:
        begins = [(since(step, "begin"), begun(step)) for step in self.steps]
        formulas = tuple(
            always([f"abs({a.name} - {b.name}) <= {self.within_s + CLOCK_S!r}"], "s", a_begun, b_begun)
            for (a, a_begun), (b, b_begun) in combinations(begins, 2)
        )
        return Specification(formulas, tuple(signal for pair in begins for signal in pair), measured=False)
