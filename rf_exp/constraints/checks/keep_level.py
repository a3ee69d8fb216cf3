from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, PlanContext
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.findings import CheckName, FactArguments, Finding, agent_names
from rf_exp.statements import KeepLevel
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, doing

MEASURED_DEG = 5.0  # extra tilt allowed when measured
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class KeepLevelCheck(BoundedCheck):
    """A carried object is not tilted from its pose at the start of the plan. Value and bound in degrees."""

    statement_type, name, unit = KeepLevel, CheckName.DIRECTION, "deg"
    finding = Finding.TILTED

    agents: tuple[int, ...]
    object: str
    within_deg: float
    text: str = ""

    @classmethod
    def from_statement(cls, statement: KeepLevel, context: PlanContext) -> "KeepLevelCheck":
        carriers = (
            context.carrying_agents(statement.object) if statement.agent is None else (statement.agent,)
        )
        return cls(carriers, statement.object, statement.within_deg, statement.sentence)

    def __repr__(self) -> str:
        return f"VD({agent_names(self.agents)}, {self.object}, level within {self.within_deg:g} deg)"

    @property
    def bounds(self) -> tuple[float, float]:
        return self.within_deg, self.within_deg + MEASURED_DEG

    def planned(self, plan: Plan) -> Evidence:
        worst = self.not_applicable(plan, self.within_deg)
        for agent in self.agents:
            for segment, start, _ in plan.trajectory(agent).intervals:
                if segment.attached != self.object:
                    continue
                poses = plan.attached_object_poses(segment)
                tilts_deg = _tilts_deg(poses, plan.scene.poses[self.object])
                row = self.worst(tilts_deg)
                if tilts_deg[row] >= worst.value:
                    facts: FactArguments = {
                        "agents": (agent,),
                        "object": self.object,
                        "doing": (doing(segment),),
                    }
                    worst = self.evidence_for(tilts_deg[row], plan.time_s(agent, start + row + 1), **facts)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        holding = [agent for agent in self.agents if scene.held[agent - 1] == self.object]
        if not holding:
            return None
        pose, start_pose = scene.poses[self.object], plan.scene.poses[self.object]
        facts: FactArguments = {"agents": (holding[0],), "object": self.object, "measured": True}
        return self.evidence_for(_tilts_deg(pose[None], start_pose)[0], scene.time_s, **facts)

    def stl(self, task: Task) -> Specification:
        name = identifier("tilt", self.object, *self.agents)
        description = f"angle of what pointed up on {self.object} when the plan began, against up"
        condition = f"one of the agents {self.agents} holds {self.object}"
        return self.formula(name, description, (f"holds_{name}", condition))


def _tilts_deg(poses: NDArray[np.float64], start_pose: Matrix) -> NDArray[np.float64]:
    """(T,) angle between up and the axis that points up at `start_pose`, of an object at poses (T, 4, 4)."""
    upward = start_pose[:3, :3].T @ UP  # in the frame of the object
    return np.degrees(np.arccos(np.clip((poses[:, :3, :3] @ upward)[:, 2], -1.0, 1.0)))
