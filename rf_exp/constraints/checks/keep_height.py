"""The gripper of an agent stays below or above a height."""

from dataclasses import dataclass

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import About, Evidence, OneAgentCheck
from rf_exp.constraints.plan import MEASURED_M, Plan
from rf_exp.constraints.stl import Specification, bounded, named
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.statements import KeepHeight
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, doing


@dataclass(frozen=True)
class KeepHeightCheck(OneAgentCheck):
    """The gripper of an agent stays below or above a height. Value and bound in metres."""

    states, name, unit = KeepHeight, CheckName.OCCUPANCY, "m"

    agent: int
    limit_m: float
    side: str  # below | above
    text: str = ""

    @classmethod
    def compiled(cls, stated: KeepHeight, plans: Plans) -> "KeepHeightCheck":
        return cls(stated.agent, stated.limit_m, stated.side, stated.sentence)

    def __repr__(self) -> str:
        return f"VSO({agent_name(self.agent)}, gripper {self.side} {self.limit_m:g} m)"

    def planned(self, plan: Plan) -> Evidence:
        heights_m = plan.paths.grippers_m(self.agent)[:, 2]
        at = int(heights_m.argmax() if self.side == "below" else heights_m.argmin())
        value, time_s = float(heights_m[at]), plan.time_s(self.agent, at)
        ok = self._keeps(value, self.limit_m)
        about: About = {"aspect": self.side, "doing": (doing(plan.segment_at(self.agent, at)),)}
        return self.found(ok, Finding.OFF_HEIGHT, value, self.limit_m, time_s, **about)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        value = float(plan.planning_scene.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])[2, 3])
        ok, now_s = self._keeps(value, self._measured_m), scene.step * CONTROL_DT_S
        about: About = {"measured": True, "aspect": self.side}
        return self.found(ok, Finding.OFF_HEIGHT, value, self._measured_m, now_s, **about)

    @property
    def _measured_m(self) -> float:
        """The bound of a measured gripper."""
        return self.limit_m + (MEASURED_M if self.side == "below" else -MEASURED_M)

    def _keeps(self, height_m: float, limit_m: float) -> bool:
        return height_m <= limit_m if self.side == "below" else height_m >= limit_m

    def stl(self, task: Task) -> Specification:
        how = f"of the measured gripper of {agent_name(self.agent)} over the table"
        comparison = "<=" if self.side == "below" else ">="
        return bounded(self, (named("height", self.agent), how), comparison, self._measured_m)
