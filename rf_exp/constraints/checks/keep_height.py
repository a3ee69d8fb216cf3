from dataclasses import dataclass

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck
from rf_exp.constraints.plan import MEASURED_M, Plan
from rf_exp.constraints.stl import Comparison, Specification, named
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.statements import KeepHeight
from rf_exp.tasks import Task
from rf_exp.types import Scene


@dataclass(frozen=True)
class KeepHeightCheck(OneAgentCheck, BoundedCheck):
    """The gripper of an agent stays below or above a height. Value and bound in metres."""

    states, name, unit = KeepHeight, CheckName.OCCUPANCY, "m"
    finding = Finding.OFF_HEIGHT

    limit_m: float
    side: str  # below | above
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({agent_name(self.agent)}, gripper {self.side} {self.limit_m:g} m)"

    @property
    def comparison(self) -> Comparison:
        return "<=" if self.side == "below" else ">="

    @property
    def bounds(self) -> tuple[float, float]:
        return self.limit_m, self.limit_m + (MEASURED_M if self.side == "below" else -MEASURED_M)

    def planned(self, plan: Plan) -> Evidence:
        heights_m = plan.paths.grippers_m(self.agent)[:, 2]
        at = self.worst(heights_m)
        does = plan.doing(self.agents, [at])
        return self.judged(heights_m[at], plan.time_s(self.agent, at), aspect=self.side, doing=does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        height_m = plan.tcp(self.agent, scene)[2, 3]
        return self.judged(height_m, scene.time_s, measured=True, aspect=self.side)

    def stl(self, task: Task) -> Specification:
        how = f"of the measured gripper of {agent_name(self.agent)} over the table"
        return self.formula(named("height", self.agent), how)
