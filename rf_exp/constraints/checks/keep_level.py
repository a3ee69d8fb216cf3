from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, Plans
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, named
from rf_exp.findings import About, CheckName, Finding, names
from rf_exp.statements import KeepLevel
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, doing

MEASURED_DEG = 5.0  # extra tilt allowed when measured
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class KeepLevelCheck(BoundedCheck):
    """A carried object is not tilted from its pose at the start of the plan. Value and bound in degrees."""

    states, name, unit = KeepLevel, CheckName.DIRECTION, "deg"
    finding = Finding.TILTED

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

    @property
    def bounds(self) -> tuple[float, float]:
        return self.within_deg, self.within_deg + MEASURED_DEG

    def planned(self, plan: Plan) -> Evidence:
        worst = self.idle(plan, self.within_deg)
        for agent in self.agents:
            for segment, start, _ in plan.trajectory(agent).intervals:
                if segment.attached != self.object:
                    continue
                poses = plan.carried(segment)
                tilts = _tilts_deg(poses, plan.scene.poses[self.object])
                row = self.worst(tilts)
                if tilts[row] >= worst.value:
                    about: About = {"agents": (agent,), "object": self.object, "doing": (doing(segment),)}
                    worst = self.judged(tilts[row], plan.time_s(agent, start + row + 1), **about)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        holding = [agent for agent in self.agents if scene.held[agent - 1] == self.object]
        if not holding:
            return None
        now, start = scene.poses[self.object], plan.scene.poses[self.object]
        about: About = {"agents": (holding[0],), "object": self.object, "measured": True}
        return self.judged(_tilts_deg(now[None], start)[0], scene.time_s, **about)

    def stl(self, task: Task) -> Specification:
        name = named("tilt", self.object, *self.agents)
        how = f"angle of what pointed up on {self.object} when the plan began, against up"
        held = f"one of the agents {self.agents} holds {self.object}"
        return self.formula(name, how, (f"holds_{name}", held))


def _tilts_deg(poses: NDArray[np.float64], stands: Matrix) -> NDArray[np.float64]:
    """(T,) angle between up and the axis that points up at pose `stands`, of an object at poses (T, 4, 4)."""
    upward = stands[:3, :3].T @ UP  # in the frame of the object
    return np.degrees(np.arccos(np.clip((poses[:, :3, :3] @ upward)[:, 2], -1.0, 1.0)))
