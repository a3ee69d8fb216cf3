from dataclasses import dataclass
from itertools import combinations

from rf_exp.constraints.check import Evidence, PlanContext
from rf_exp.constraints.phases import TimedCheck, begun_signal, elapsed_signal, step_suffix, steps_within
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import TIME_TOLERANCE_S, Specification, always
from rf_exp.coordination import Demands
from rf_exp.findings import Finding, agent_names
from rf_exp.statements import TOGETHER_S, Step, Together
from rf_exp.tasks import Task


@dataclass(frozen=True)
class TogetherCheck(TimedCheck):
    """Several agents begin the same part at most `within_s` apart. Value and bound in seconds."""

    statement_type = Together

    steps: tuple[Step, ...]
    within_s: float = TOGETHER_S
    text: str = ""

    @classmethod
    def from_statement(cls, statement: Together, context: PlanContext) -> "TogetherCheck":
        steps = tuple(
            context.step(Step(agent, statement.verb, statement.object)) for agent in statement.agents
        )
        return cls(steps, statement.within_s, statement.sentence)

    def __repr__(self) -> str:
        step = step_suffix(self.steps[0])
        return f"VS({agent_names(self.agents)}, simultaneous{step}, within {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        for (a, start_a, _), (b, start_b, _) in combinations(self.spans(demands), 2):
            demands.together(a, start_a, b, start_b, steps_within(self.within_s))

    def planned(self, plan: Plan) -> Evidence:
        starts_s = [start_s for start_s, _ in self.times_s(plan)]
        if len(starts_s) < 2:
            return self.not_applicable(plan, self.within_s)
        spread_s, subgoals = max(starts_s) - min(starts_s), (self.steps[0].action_text("their tasks"),)
        ok, last_start_s = spread_s <= self.within_s + 1e-9, plan.begins_s + max(starts_s)
        return self.make_evidence(
            ok, Finding.NOT_TOGETHER, spread_s, self.within_s, last_start_s, subgoals=subgoals
        )

    def stl(self, task: Task) -> Specification:
        start_signals = [(elapsed_signal(step, "begin"), begun_signal(step)) for step in self.steps]
        formulas = tuple(
            always(
                [f"abs({a.name} - {b.name}) <= {self.within_s + TIME_TOLERANCE_S!r}"], "s", a_begun, b_begun
            )
            for (a, a_begun), (b, b_begun) in combinations(start_signals, 2)
        )
        return Specification(
            formulas, tuple(signal for pair in start_signals for signal in pair), measured=False
        )
