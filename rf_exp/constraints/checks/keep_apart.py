from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import BoundedCheck, Evidence
from rf_exp.constraints.plan import MEASURED_M, Paths, Plan
from rf_exp.constraints.stl import Specification, named
from rf_exp.coordination import Closing
from rf_exp.findings import CheckName, Finding, agent_name, names
from rf_exp.geometry import PlanningScene, Swept, closer_than, nearest
from rf_exp.statements import KeepApart
from rf_exp.tasks import Task
from rf_exp.types import Scene


@dataclass(frozen=True)
class KeepApartCheck(BoundedCheck):
    """Two grippers, or two arms, keep a distance. Value and bound in metres."""

    states, name, unit = KeepApart, CheckName.OCCUPANCY, "m"
    finding, comparison = Finding.TOO_NEAR, ">="

    agents: tuple[int, int]
    at_least_m: float
    parts: str  # grippers | arms
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)}, {self.parts} {self.at_least_m:g} m apart)"

    @property
    def bounds(self) -> tuple[float, float]:
        return self.at_least_m, max(0.0, self.at_least_m - MEASURED_M)

    def rule(self, paths: Paths) -> Closing:
        if self.parts == "arms":
            return Closing(self.agents, closer_than(*self._links(paths), self.at_least_m))
        a_m, b_m = (paths.grippers_m(agent) for agent in self.agents)
        return Closing(self.agents, np.linalg.norm(a_m[:, None] - b_m[None], axis=-1) < self.at_least_m)

    def _links(self, paths: Paths) -> tuple[Swept, Swept]:
        """The two arms along their paths, without carried objects."""
        a, b = (paths.swept[agent - 1] for agent in self.agents)
        return a.only(*set(a.labels) - a.objects), b.only(*set(b.labels) - b.objects)

    def planned(self, plan: Plan) -> Evidence:
        at = np.stack([plan.positions(agent) for agent in self.agents], axis=1)
        if self.parts == "arms":
            gap = nearest(*self._links(plan.paths), at)
            value, step = gap.distance_m, plan.first_step(self.agents, gap.at)
        else:
            a_m, b_m = (plan.paths.grippers_m(agent)[at[:, row]] for row, agent in enumerate(self.agents))
            apart_m = np.linalg.norm(a_m - b_m, axis=1)
            step = self.worst(apart_m)
            value = apart_m[step]
        does = plan.doing(self.agents, at[step])
        return self.judged(value, plan.step_s(step), aspect=self.parts, doing=does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        if self.parts == "arms":
            apart_m = PlanningScene(plan.task, scene).between(*self.agents).distance_m
        else:
            a, b = (plan.tcp(agent, scene)[:3, 3] for agent in self.agents)
            apart_m = float(np.linalg.norm(a - b))
        return self.judged(apart_m, scene.time_s, measured=True, aspect=self.parts)

    def stl(self, task: Task) -> Specification:
        how = f"between the measured {self.parts} of {' and '.join(map(agent_name, self.agents))}"
        return self.formula(named("distance", self.parts, *self.agents), how)
