from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import BoundedCheck, Evidence
from rf_exp.constraints.plan import MEASUREMENT_TOLERANCE_M, Paths, Plan
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.coordination import ForbiddenPairs
from rf_exp.findings import CheckName, Finding, agent_name, agent_names
from rf_exp.geometry import PlanningScene, Swept, closer_than, nearest
from rf_exp.statements import KeepApart
from rf_exp.tasks import Task
from rf_exp.types import Scene


@dataclass(frozen=True)
class KeepApartCheck(BoundedCheck):
    """Two grippers, or two arms, keep a distance. Value and bound in metres."""

    statement_type, name, unit = KeepApart, CheckName.OCCUPANCY, "m"
    finding, comparison = Finding.TOO_NEAR, ">="

    agents: tuple[int, int]
    at_least_m: float
    parts: str  # grippers | arms
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({agent_names(self.agents)}, {self.parts} {self.at_least_m:g} m apart)"

    @property
    def bounds(self) -> tuple[float, float]:
        return self.at_least_m, max(0.0, self.at_least_m - MEASUREMENT_TOLERANCE_M)

    def rule(self, paths: Paths) -> ForbiddenPairs:
        if self.parts == "arms":
            return ForbiddenPairs(self.agents, closer_than(*self._arm_bodies(paths), self.at_least_m))
        a_m, b_m = (paths.gripper_positions_m(agent) for agent in self.agents)
        return ForbiddenPairs(
            self.agents, np.linalg.norm(a_m[:, None] - b_m[None], axis=-1) < self.at_least_m
        )

    def _arm_bodies(self, paths: Paths) -> tuple[Swept, Swept]:
        """The two arms along their paths, without carried objects."""
        a, b = (paths.swept[agent - 1] for agent in self.agents)
        return a.only(*set(a.labels) - a.objects), b.only(*set(b.labels) - b.objects)

    def planned(self, plan: Plan) -> Evidence:
        positions = np.stack([plan.positions(agent) for agent in self.agents], axis=1)
        if self.parts == "arms":
            gap = nearest(*self._arm_bodies(plan.paths), positions)
            value, step = gap.distance_m, plan.first_step(self.agents, gap.at)
        else:
            a_m, b_m = (
                plan.paths.gripper_positions_m(agent)[positions[:, row]]
                for row, agent in enumerate(self.agents)
            )
            distances_m = np.linalg.norm(a_m - b_m, axis=1)
            step = self.worst(distances_m)
            value = distances_m[step]
        activities = plan.doing(self.agents, positions[step])
        return self.evidence_for(value, plan.step_end_s(step), aspect=self.parts, doing=activities)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        if self.parts == "arms":
            distance_m = PlanningScene(plan.task, scene).between(*self.agents).distance_m
        else:
            a, b = (plan.tcp(agent, scene)[:3, 3] for agent in self.agents)
            distance_m = float(np.linalg.norm(a - b))
        return self.evidence_for(distance_m, scene.time_s, measured=True, aspect=self.parts)

    def stl(self, task: Task) -> Specification:
        description = f"between the measured {self.parts} of {' and '.join(map(agent_name, self.agents))}"
        return self.formula(identifier("distance", self.parts, *self.agents), description)
