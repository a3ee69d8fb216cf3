"""What agents carry is kept level."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import About, Check, Evidence
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, bounded, named
from rf_exp.findings import CheckName, Doing, Finding, names
from rf_exp.statements import KeepLevel
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_DT_S, Scene, doing

MEASURED_DEG = 5.0  # that a measured thing may be tilted more than planned
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class KeepLevelCheck(Check):
    """What agents carry is not tilted against how it stands now. Value and bound in degrees."""

    states, name, unit = KeepLevel, CheckName.DIRECTION, "deg"

    agents: tuple[int, ...]
    object: str
    within_deg: float
    text: str = ""

    @classmethod
    def compiled(cls, stated: KeepLevel, plans: Plans) -> "KeepLevelCheck":
        carriers = plans.carriers(stated.object) if stated.agent is None else (stated.agent,)
        return cls(carriers, stated.object, stated.within_deg, stated.sentence)

    def __repr__(self) -> str:
        return f"VD({names(self.agents)}, {self.object}, level within {self.within_deg:g} deg)"

    def planned(self, plan: Plan) -> Evidence:
        worst = self.idle(plan, self.within_deg)
        for agent in self.agents:
            trajectory = plan.trajectory(agent)
            starts = trajectory.knots[:-1]
            for segment, start in zip(trajectory.segments, starts, strict=True):
                if segment.attached != self.object:
                    continue
                assert segment.tcp_from_object is not None  # PlanningScene.along has refused it otherwise
                poses = plan.planning_scene.arms[agent - 1].tcp(segment.qpos) @ segment.tcp_from_object
                tilts = _tilts_deg(poses, plan.scene.poses[self.object])
                row = int(tilts.argmax())
                if tilts[row] >= worst.value:
                    time_s = plan.time_s(agent, start + row + 1)
                    worst = self._tilted(float(tilts[row]), self.within_deg, time_s, agent, doing(segment))
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        holding = [agent for agent in self.agents if scene.held[agent - 1] == self.object]
        if not holding:
            return None
        now, start = scene.poses[self.object], plan.scene.poses[self.object]
        tilt, now_s = float(_tilts_deg(now[None], start)[0]), scene.step * CONTROL_DT_S
        return self._tilted(tilt, self.within_deg + MEASURED_DEG, now_s, holding[0])

    def _tilted(
        self, value: float, bound: float, time_s: float, agent: int, does: Doing | None = None
    ) -> Evidence:
        """`does` is what the agent is about as planned; None as measured."""
        about: About = {"agents": (agent,), "measured": does is None, "object": self.object}
        about["doing"] = () if does is None else (does,)
        return self.found(value <= bound, Finding.TILTED, value, bound, time_s, **about)

    def stl(self, task: Task) -> Specification:
        name = named("tilt", self.object, *self.agents)
        how = f"angle of what pointed up on {self.object} when the plan began, against up"
        held = f"one of the agents {self.agents} holds {self.object}"
        return bounded(self, (name, how), "<=", self.within_deg + MEASURED_DEG, (f"holds_{name}", held))


def _tilts_deg(poses: NDArray[np.float64], stands: Matrix) -> NDArray[np.float64]:
    """(T,) of an object at poses (T, 4, 4): the angle of what points up where it stands, against up."""
    upward = stands[:3, :3].T @ UP  # in the frame of the object
    return np.degrees(np.arccos(np.clip((poses[:, :3, :3] @ upward)[:, 2], -1.0, 1.0)))
