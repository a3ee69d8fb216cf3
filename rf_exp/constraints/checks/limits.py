"""Checks of limits: the tilt of what is carried, heights and speeds of grippers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.slowing import speeds_m_s
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName, Doing, Finding, agent_name, names
from rf_exp.timeline import doing
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_DT_S, Kind, Scene, Segment

MEASURED_M = 0.02  # that a measured gripper may be beside the planned one
MEASURED_DEG = 5.0
MEASURED_SPEED = 1.25  # an arm that catches up with its command is faster than it
UP = np.array([0.0, 0.0, 1.0])


def grippers_m(paths: Paths, agent: int) -> NDArray[np.float64]:
    """(P, 3) the tool centre point of an agent at its path positions, world frame."""
    return paths.planning_scene.arms[agent - 1].tcp(paths.trajectory(agent).path())[:, :3, 3]


@dataclass(frozen=True)
class Tilt:
    """What agents carry is not tilted against how it stands now. Value and bound in degrees."""

    kind: ClassVar[Kind] = "logical"
    name: ClassVar[CheckName] = CheckName.DIRECTION
    unit: ClassVar[str] = "deg"

    agents: tuple[int, ...]
    object: str
    within_deg: float
    text: str = ""

    def __repr__(self) -> str:
        return f"VD({names(self.agents)}, {self.object}, level within {self.within_deg:g} deg)"

    def planned(self, plan: Plan) -> Evidence:
        worst = idle(plan, self.agents, bound=self.within_deg)
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
                    worst = self._evidence(float(tilts[row]), self.within_deg, time_s, agent, segment)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        holding = [agent for agent in self.agents if scene.held[agent - 1] == self.object]
        if not holding:
            return None
        now, start = scene.poses[self.object], plan.scene.poses[self.object]
        tilt = float(_tilts_deg(now[None], start)[0])
        time_s = scene.step * CONTROL_DT_S
        return self._evidence(tilt, self.within_deg + MEASURED_DEG, time_s, holding[0])

    def _evidence(
        self, value: float, bound: float, time_s: float, agent: int, planned: Segment | None = None
    ) -> Evidence:
        return Evidence(
            ok=value <= bound,
            finding=Finding.TILTED,
            value=value,
            bound=bound,
            time_s=time_s,
            agents=(agent,),
            measured=planned is None,
            object=self.object,
            doing=() if planned is None else (doing(planned),),
        )


def _tilts_deg(poses: NDArray[np.float64], stands: Matrix) -> NDArray[np.float64]:
    """(T,) of an object at poses (T, 4, 4): the angle of what points up where it stands, against up."""
    upward = stands[:3, :3].T @ UP  # in the frame of the object
    return np.degrees(np.arccos(np.clip((poses[:, :3, :3] @ upward)[:, 2], -1.0, 1.0)))


@dataclass(frozen=True)
class Height:
    """The gripper of an agent stays below or above a height. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agent: int
    limit_m: float
    side: str  # below | above
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def __repr__(self) -> str:
        return f"VSO({agent_name(self.agent)}, gripper {self.side} {self.limit_m:g} m)"

    def planned(self, plan: Plan) -> Evidence:
        heights_m = grippers_m(plan.paths, self.agent)[:, 2]
        at = int(heights_m.argmax() if self.side == "below" else heights_m.argmin())
        does = doing(plan.segment_at(self.agent, at))
        return self._evidence(float(heights_m[at]), self.limit_m, plan.time_s(self.agent, at), False, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        tcp = plan.planning_scene.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        slack_m = MEASURED_M if self.side == "below" else -MEASURED_M
        now_s = scene.step * CONTROL_DT_S
        return self._evidence(float(tcp[2, 3]), self.limit_m + slack_m, now_s, True)

    def _evidence(
        self, value: float, bound_m: float, time_s: float, measured: bool, does: Doing | None = None
    ) -> Evidence:
        return Evidence(
            ok=value <= bound_m if self.side == "below" else value >= bound_m,
            finding=Finding.OFF_HEIGHT,
            value=value,
            bound=bound_m,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            aspect=self.side,
            doing=() if measured else (does,),
        )


@dataclass(frozen=True)
class Speed:
    """The gripper of an agent is not too fast. Value and bound in metres a second."""

    kind: ClassVar[Kind] = "temporal"
    name: ClassVar[CheckName] = CheckName.SCHEDULING
    unit: ClassVar[str] = "m/s"

    agent: int
    at_most_m_s: float
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def __repr__(self) -> str:
        return f"VS({agent_name(self.agent)}, at most {self.at_most_m_s:g} m/s)"

    def demand(self, demands: Demands) -> None:
        """Nothing: paths are made that slow (`slowed`), whatever their schedule."""

    def planned(self, plan: Plan) -> Evidence:
        speeds = speeds_m_s(plan.planning_scene.arms[self.agent - 1], plan.trajectory(self.agent).path())
        if not len(speeds):
            return idle(plan, self.agents, bound=self.at_most_m_s)
        at = int(speeds.argmax())
        time_s, does = plan.time_s(self.agent, at + 1), doing(plan.segment_at(self.agent, at + 1))
        return self._evidence(float(speeds[at]), self.at_most_m_s, time_s, False, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        qpos, qvel = scene.qpos[self.agent - 1], scene.qvel[self.agent - 1]
        path = np.stack([qpos, qpos + qvel * CONTROL_DT_S])
        value = float(speeds_m_s(plan.planning_scene.arms[self.agent - 1], path)[0])
        bound = self.at_most_m_s * MEASURED_SPEED
        return self._evidence(value, bound, scene.step * CONTROL_DT_S, True)

    def _evidence(
        self, value: float, bound: float, time_s: float, measured: bool, does: Doing | None = None
    ) -> Evidence:
        return Evidence(
            ok=value <= bound * (1 + 1e-9),
            finding=Finding.TOO_FAST,
            value=value,
            bound=bound,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            doing=() if measured else (does,),
        )
