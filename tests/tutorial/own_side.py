"""Custom constraint: the gripper of an agent stays nearer to its own base than to any other one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import BoundedCheck, Evidence, OneAgentCheck, Plan
from rf_exp.constraints.stl import Specification
from rf_exp.findings import CheckName, Finding
from rf_exp.statements import OneAgentStatement, agent_name
from rf_exp.tasks import Task
from rf_exp.types import Scene


@dataclass(frozen=True)
class OwnSide(OneAgentStatement):
    """The gripper of an agent stays nearer to its own base than to any other one."""

    kind = "spatial"
    patterns = (r"{agent} {must} (?:stay|remain|keep) (?:on|to) its (?:own )?side(?: of the table)?",)

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must stay on its own side."


OwnSide.samples = (OwnSide(1),)


@dataclass(frozen=True)
class OwnSideCheck(OneAgentCheck, BoundedCheck):
    """Check of `OwnSide`: how much nearer the gripper is to its own base. Value and bound in metres."""

    statement_type, name, unit = OwnSide, CheckName.OCCUPANCY, "m"
    finding, comparison, bounds = Finding.CONSTRAINT, ">", (0.0, 0.0)  # bounds: as planned, as measured

    text: str

    def planned(self, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, plan.trajectory(self.agent).path())
        at = self.worst(nearer_m)
        return self.evidence_for(nearer_m[at], plan.time_s(self.agent, at))

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, scene.qpos[self.agent - 1][None])
        return self.evidence_for(nearer_m[0], scene.time_s, measured=True)

    def _nearer_m(self, plan: Plan, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """(P,) how much nearer the tool centre point at joints (P, 7 or more) is to the own base."""
        bases_m = np.array([(robot.x_m, robot.y_m) for robot in plan.task.robots])
        tcp_m = plan.planning_scene.arms[self.agent - 1].tcp(qpos)[:, :2, 3]
        distances_m = np.linalg.norm(tcp_m[:, None] - bases_m, axis=2)
        return np.delete(distances_m, self.agent - 1, axis=1).min(axis=1) - distances_m[:, self.agent - 1]

    def stl(self, task: Task) -> Specification:
        description = (
            f"how much nearer the gripper of Agent_{self.agent} is to its own base than to any other one"
        )
        return self.formula(f"nearer_{self.agent}", description)
