"""The gripper of an agent is not too fast."""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import Evidence, OneAgentCheck
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.slowing import speeds_m_s
from rf_exp.constraints.stl import Specification, bounded, named
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.statements import SpeedLimit
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, doing

MEASURED_SPEED = 1.25  # an arm that catches up with its command is faster than it
_ROUNDING = 1 + 1e-9


@dataclass(frozen=True)
class SpeedLimitCheck(OneAgentCheck):
    """The gripper of an agent is not too fast. Value and bound in metres a second.

    Paths are made that slow (`slowed`), whatever their schedule, so it has no rule for timing.
    """

    states, name, unit = SpeedLimit, CheckName.SCHEDULING, "m/s"

    agent: int
    at_most_m_s: float
    text: str = ""

    @classmethod
    def compiled(cls, stated: SpeedLimit, plans: Plans) -> "SpeedLimitCheck":
        return cls(stated.agent, stated.at_most_m_s, stated.sentence)

    def __repr__(self) -> str:
        return f"VS({agent_name(self.agent)}, at most {self.at_most_m_s:g} m/s)"

    def planned(self, plan: Plan) -> Evidence:
        speeds = speeds_m_s(plan.planning_scene.arms[self.agent - 1], plan.trajectory(self.agent).path())
        if not len(speeds):
            return self.idle(plan, self.at_most_m_s)
        at = int(speeds.argmax())
        value, bound, time_s = float(speeds[at]), self.at_most_m_s, plan.time_s(self.agent, at + 1)
        does = (doing(plan.segment_at(self.agent, at + 1)),)
        return self.found(value <= bound * _ROUNDING, Finding.TOO_FAST, value, bound, time_s, doing=does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        qpos, qvel = scene.qpos[self.agent - 1], scene.qvel[self.agent - 1]
        path = np.stack([qpos, qpos + qvel * CONTROL_DT_S])
        value = float(speeds_m_s(plan.planning_scene.arms[self.agent - 1], path)[0])
        bound, now_s = self.at_most_m_s * MEASURED_SPEED, scene.step * CONTROL_DT_S
        return self.found(value <= bound * _ROUNDING, Finding.TOO_FAST, value, bound, now_s, measured=True)

    def stl(self, task: Task) -> Specification:
        how = f"of the gripper of {agent_name(self.agent)}, by measured joint positions and velocities"
        bound = self.at_most_m_s * MEASURED_SPEED * _ROUNDING
        return bounded(self, (named("speed", self.agent), how), "<=", bound)
