"""A kind of constraint of one's own: the gripper of an agent stays nearest to its own base."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Check, Evidence, Plan, check_of
from rf_exp.constraints.stl import Specification, bounded, stl_of
from rf_exp.findings import CheckName
from rf_exp.statements import Form, OfAgent, agent_name
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
class NearOwnBase:
    """The check of `OwnSide`: how much nearer the own base is. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agent: int
    text: str

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def planned(self, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, plan.trajectory(self.agent).path())
        return self._evidence(nearer_m.min(), plan.time_s(self.agent, int(nearer_m.argmin())))

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        nearer_m = self._nearer_m(plan, scene.qpos[self.agent - 1][None])
        return self._evidence(nearer_m.min(), scene.step * CONTROL_DT_S, True)

    def _nearer_m(self, plan: Plan, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """(P,) of the tool centre point at joints (P, 7 or more)."""
        bases_m = np.array([(robot.x_m, robot.y_m) for robot in plan.task.robots])
        tcp_m = plan.planning_scene.arms[self.agent - 1].tcp(qpos)[:, :2, 3]
        away_m = np.linalg.norm(tcp_m[:, None] - bases_m, axis=2)
        return np.delete(away_m, self.agent - 1, axis=1).min(axis=1) - away_m[:, self.agent - 1]

    def _evidence(self, nearer_m: float, time_s: float, measured: bool = False) -> Evidence:
        return Evidence(
            ok=bool(nearer_m > 0),
            value=float(nearer_m),
            unit=self.unit,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            constraint=self.text,
        )


@check_of.register
def _(stated: OwnSide, plans: object) -> Check:
    return NearOwnBase(stated.agent, stated.sentence)


@stl_of.register
def _(check: NearOwnBase, task: object) -> Specification:
    how = f"how much nearer the gripper of Agent_{check.agent} is to its own base than to any other one"
    return bounded(check, (f"nearer_{check.agent}", how), ">", 0.0)
