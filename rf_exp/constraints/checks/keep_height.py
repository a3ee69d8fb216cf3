from dataclasses import dataclass

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck
from rf_exp.constraints.plan import MEASUREMENT_TOLERANCE_M, Plan
from rf_exp.constraints.stl import Comparison, Specification, identifier
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.statements import KeepHeight
from rf_exp.tasks import Task
from rf_exp.types import Scene


@dataclass(frozen=True)
class KeepHeightCheck(OneAgentCheck, BoundedCheck):
    """The gripper of an agent stays below or above a height. Value and bound in metres."""

    statement_type, name, unit = KeepHeight, CheckName.OCCUPANCY, "m"
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
        return self.limit_m, self.limit_m + (
            MEASUREMENT_TOLERANCE_M if self.side == "below" else -MEASUREMENT_TOLERANCE_M
        )

    def planned(self, plan: Plan) -> Evidence:
        heights_m = plan.paths.gripper_positions_m(self.agent)[:, 2]
        position = self.worst(heights_m)
        activities = plan.doing(self.agents, [position])
        return self.evidence_for(
            heights_m[position], plan.time_s(self.agent, position), aspect=self.side, doing=activities
        )

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        height_m = plan.tcp(self.agent, scene)[2, 3]
        return self.evidence_for(height_m, scene.time_s, measured=True, aspect=self.side)

    def stl(self, task: Task) -> Specification:
        description = f"of the measured gripper of {agent_name(self.agent)} over the table"
        return self.formula(identifier("height", self.agent), description)
