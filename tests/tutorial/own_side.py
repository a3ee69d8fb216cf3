"""A kind of constraint of one's own: the gripper of an agent stays nearest to its own base."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Evidence, OneAgentCheck, Plan, Plans
from rf_exp.constraints.stl import Specification, bounded
from rf_exp.findings import CheckName, Finding
from rf_exp.statements import Form, OfAgent, agent_name
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Kind, Scene


@dataclass(frozen=True)
class OwnSide(OfAgent):
    """The gripper of an agent stays nearer to its own base than to any other one."""

    kind: ClassVar[Kind] = "spatial"

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must stay on its own side."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        said = r"{agent} {must} (?:stay|remain|keep) (?:on|to) its (?:own )?side(?: of the table)?"
        return (Form(said, lambda words: cls(words.agent())),)


OwnSide.samples = (OwnSide(1),)


@dataclass(frozen=True)
class OwnSideCheck(OneAgentCheck):
    """How much nearer the gripper of an agent is to its own base. Value and bound in metres."""

    states, name, unit = OwnSide, CheckName.OCCUPANCY, "m"

    agent: int
    text: str

    @classmethod
    def compiled(cls, stated: OwnSide, plans: Plans) -> "OwnSideCheck":
        return cls(stated.agent, stated.sentence)

    def planned(self, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, plan.trajectory(self.agent).path())
        return self._nearer(nearer_m.min(), plan.time_s(self.agent, int(nearer_m.argmin())), False)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, scene.qpos[self.agent - 1][None])
        return self._nearer(nearer_m.min(), scene.step * CONTROL_DT_S, True)

    def _nearer_m(self, plan: Plan, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """(P,) of the tool centre point at joints (P, 7 or more)."""
        bases_m = np.array([(robot.x_m, robot.y_m) for robot in plan.task.robots])
        tcp_m = plan.planning_scene.arms[self.agent - 1].tcp(qpos)[:, :2, 3]
        away_m = np.linalg.norm(tcp_m[:, None] - bases_m, axis=2)
        return np.delete(away_m, self.agent - 1, axis=1).min(axis=1) - away_m[:, self.agent - 1]

    def _nearer(self, nearer_m: float, time_s: float, measured: bool) -> Evidence:
        ok = bool(nearer_m > 0)
        return self.found(ok, Finding.CONSTRAINT, float(nearer_m), 0.0, time_s, measured=measured)

    def stl(self, task: Task) -> Specification:
        how = f"how much nearer the gripper of Agent_{self.agent} is to its own base than to any other one"
        return bounded(self, (f"nearer_{self.agent}", how), ">", 0.0)
