"""The gripper of an agent is not too fast."""

from dataclasses import dataclass
from typing import Unpack

import numpy as np

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import Evidence, OneAgentCheck
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.slowing import speeds_m_s
from rf_exp.constraints.stl import Specification, bounded, named
from rf_exp.findings import About, CheckName, Finding, agent_name
from rf_exp.statements import SpeedLimit
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene

MEASURED_SPEED = 1.25  # an arm that catches up with its command is faster than it
_ROUNDING = 1 + 1e-9


@dataclass(frozen=True)
class SpeedLimitCheck(OneAgentCheck):
    """The gripper of an agent is not too fast. Value and bound in metres a second.

    Paths are made that slow (`slowed`), whatever their schedule, so it has no rule for timing.
    """

    states, name, unit = SpeedLimit, CheckName.SCHEDULING, "m/s"

    at_most_m_s: float
    text: str = ""

    @classmethod
    def compiled(cls, stated: SpeedLimit, plans: Plans) -> "SpeedLimitCheck":
        return cls(stated.agent, stated.at_most_m_s, stated.sentence)

    def __repr__(self) -> str:
        return f"VS({agent_name(self.agent)}, at most {self.at_most_m_s:g} m/s)"

    def planned(self, plan: Plan) -> Evidence:
        speeds = speeds_m_s(plan.arm(self.agent), plan.trajectory(self.agent).path())
        if not len(speeds):
            return self.idle(plan, self.at_most_m_s)
        fastest = int(speeds.argmax())
        time_s, does = plan.time_s(self.agent, fastest + 1), plan.doing(self.agents, [fastest + 1])
        return self._moves(speeds[fastest], self.at_most_m_s, time_s, doing=does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        qpos, qvel = scene.qpos[self.agent - 1], scene.qvel[self.agent - 1]
        path = np.stack([qpos, qpos + qvel * CONTROL_DT_S])
        speed = speeds_m_s(plan.arm(self.agent), path)[0]
        return self._moves(speed, self.at_most_m_s * MEASURED_SPEED, scene.time_s, measured=True)

    def _moves(self, value: float, bound: float, time_s: float, **about: Unpack[About]) -> Evidence:
        ok = bool(value <= bound * _ROUNDING)
        return self.found(ok, Finding.TOO_FAST, float(value), bound, time_s, **about)

    def stl(self, task: Task) -> Specification:
        how = f"of the gripper of {agent_name(self.agent)}, by measured joint positions and velocities"
        bound = self.at_most_m_s * MEASURED_SPEED * _ROUNDING
        return bounded(self, (named("speed", self.agent), how), "<=", bound)
