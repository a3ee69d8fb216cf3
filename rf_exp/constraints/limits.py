"""Checks of limits: the distance of two agents, the tilt of what is carried, heights and speeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.spatial import Closing
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName, Doing, Finding, agent_name, names
from rf_exp.geometry import Bodies, Mask, Swept, closer_than, nearest
from rf_exp.robots import LINKS, Panda
from rf_exp.timeline import doing
from rf_exp.transforms import Matrix
from rf_exp.types import ARM_JOINTS, CONTROL_DT_S, Kind, Scene, Segment, Trajectory

MEASURED_M = 0.02  # that a measured gripper may be beside the planned one
MEASURED_DEG = 5.0
SPARE = 1.02  # straight lines between positions in joint space are none of the gripper
MEASURED_SPEED = 1.25  # an arm that catches up with its command is faster than it
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Distance:
    """Two grippers, or two arms, keep a distance. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agents: tuple[int, int]
    at_least_m: float
    parts: str  # grippers | arms
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)}, {self.parts} {self.at_least_m:g} m apart)"

    def closing(self, paths: Paths) -> Closing:
        """What timing has to do about it."""
        return Closing(self.agents, self._close(paths))

    def _close(self, paths: Paths) -> Mask:
        """(P_i, P_j) the pairs of path positions at which they are too close."""
        if self.parts == "arms":
            a, b = (_links(paths.swept[agent - 1]) for agent in self.agents)
            return closer_than(a, b, self.at_least_m)
        a_m, b_m = (_grippers_m(paths, agent) for agent in self.agents)
        return np.linalg.norm(a_m[:, None] - b_m[None], axis=-1) < self.at_least_m

    def planned(self, plan: Plan) -> Evidence:
        at = np.stack([plan.positions(agent) for agent in self.agents], axis=1)
        if self.parts == "arms":
            a, b = (_links(plan.paths.swept[agent - 1]) for agent in self.agents)
            gap = nearest(a, b, at)
            assert gap is not None  # links must always keep apart
            value, step = gap.distance_m, int(np.flatnonzero((at == gap.at).all(axis=1))[0])
        else:
            a_m, b_m = (_grippers_m(plan.paths, agent)[at[:, row]] for row, agent in enumerate(self.agents))
            apart_m = np.linalg.norm(a_m - b_m, axis=1)
            step = int(apart_m.argmin())
            value = float(apart_m[step])
        time_s = plan.begins_s + step * CONTROL_DT_S
        does = tuple(
            doing(plan.segment_at(agent, int(position)))
            for agent, position in zip(self.agents, at[step], strict=True)
        )
        return self._evidence(value, self.at_least_m, time_s, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        bodies = Bodies(plan.task, scene)
        if self.parts == "arms":
            value = bodies.between(*self.agents).distance_m
        else:
            a, b = (bodies.arms[agent - 1].tcp(scene.qpos[agent - 1])[:3, 3] for agent in self.agents)
            value = float(np.linalg.norm(a - b))
        bound_m = max(0.0, self.at_least_m - MEASURED_M)
        return self._evidence(value, bound_m, scene.step * CONTROL_DT_S, None)

    def _evidence(
        self, value: float, bound_m: float, time_s: float, does: tuple[Doing | None, ...] | None
    ) -> Evidence:
        """`does`: what each agent is about, as planned; None as measured."""
        return Evidence(
            ok=value >= bound_m,
            finding=Finding.TOO_NEAR,
            value=value,
            bound=bound_m,
            time_s=time_s,
            agents=self.agents,
            measured=does is None,
            aspect=self.parts,
            doing=does or (),
        )


def _grippers_m(paths: Paths, agent: int) -> NDArray[np.float64]:
    """(P, 3) the tool centre point of an agent at its path positions, world frame."""
    return paths.bodies.arms[agent - 1].tcp(paths.trajectory(agent).path())[:, :3, 3]


def _links(body: Swept) -> Swept:
    """An arm without what it carries, at its path positions; nothing of it may touch anything."""
    columns = [column for column, label in enumerate(body.labels) if label in LINKS]
    return Swept(
        tuple(body.pieces[column] for column in columns),
        tuple(body.labels[column] for column in columns),
        body.poses[:, columns],
    )


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
                if segment.carries != self.object:
                    continue
                assert segment.tcp_from_object is not None  # Bodies.along has refused it otherwise
                poses = plan.bodies.arms[agent - 1].tcp(segment.qpos) @ segment.tcp_from_object
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
        heights_m = _grippers_m(plan.paths, self.agent)[:, 2]
        at = int(heights_m.argmax() if self.side == "below" else heights_m.argmin())
        does = doing(plan.segment_at(self.agent, at))
        return self._evidence(float(heights_m[at]), self.limit_m, plan.time_s(self.agent, at), False, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        tcp = plan.bodies.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
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
        speeds = speeds_m_s(plan.bodies.arms[self.agent - 1], plan.trajectory(self.agent).path())
        if not len(speeds):
            return idle(plan, self.agents, bound=self.at_most_m_s)
        at = int(speeds.argmax())
        time_s, does = plan.time_s(self.agent, at + 1), doing(plan.segment_at(self.agent, at + 1))
        return self._evidence(float(speeds[at]), self.at_most_m_s, time_s, False, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        qpos, qvel = scene.qpos[self.agent - 1], scene.qvel[self.agent - 1]
        path = np.stack([qpos, qpos + qvel * CONTROL_DT_S])
        value = float(speeds_m_s(plan.bodies.arms[self.agent - 1], path)[0])
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


def speeds_m_s(arm: Panda, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P - 1,) of the tool centre point between path positions (P, 7 or more) a control step apart."""
    return np.linalg.norm(np.diff(arm.tcp(path)[:, :3, 3], axis=0), axis=1) / CONTROL_DT_S


def slowed(
    trajectories: Sequence[Trajectory], arms: Sequence[Panda], limits_m_s: Mapping[int, float]
) -> tuple[Trajectory, ...]:
    """The same paths, with every segment of an agent so slow that its gripper keeps to the agent's limit.

    Segments that several agents make together stay together. Without limits they are returned as they are.
    """
    if not limits_m_s:
        return tuple(trajectories)
    factors = {  # (agent, index of the segment) -> how much longer it takes
        (trajectory.agent, index): factor
        for trajectory in trajectories
        for index, factor in enumerate(_factors(trajectory, arms, limits_m_s.get(trajectory.agent, np.inf)))
    }
    joined: dict[str, float] = {}
    for trajectory in trajectories:
        for index, segment in enumerate(trajectory.segments):
            if segment.joined is not None:
                factor = factors[trajectory.agent, index]
                joined[segment.joined] = max(factor, joined.get(segment.joined, 1.0))
    found = []
    for trajectory in trajectories:
        segments, last = [], trajectory.path()[0]
        for index, segment in enumerate(trajectory.segments):
            factor = joined.get(segment.joined or "", factors[trajectory.agent, index])
            segments.append(_stretched(segment, last, factor))
            last = np.append(segment.qpos[-1], segment.gripper[-1])
        found.append(replace(trajectory, segments=tuple(segments)))
    return tuple(found)


def _factors(trajectory: Trajectory, arms: Sequence[Panda], limit_m_s: float) -> list[float]:
    path, factors = trajectory.path(), []
    for start, end in zip(trajectory.knots[:-1], trajectory.knots[1:], strict=True):
        speeds = speeds_m_s(arms[trajectory.agent - 1], path[start : end + 1])
        fastest = float(speeds.max())
        factors.append(fastest / limit_m_s * SPARE if fastest > limit_m_s else 1.0)
    return factors


def _stretched(segment: Segment, before: NDArray[np.float64], factor: float) -> Segment:
    """A segment on a grid of so many times its steps, straight between its positions."""
    if factor <= 1.0:
        return segment
    path = np.vstack([before, np.column_stack([segment.qpos, segment.gripper])])
    steps = int(np.ceil(len(segment) * factor))
    at = np.arange(1, steps + 1) * len(segment) / steps
    rows = np.column_stack([np.interp(at, np.arange(len(path)), column) for column in path.T])
    rows[:, ARM_JOINTS] = segment.gripper[np.ceil(at - 1e-9).astype(int) - 1]  # commands do not blend
    return replace(segment, qpos=rows[:, :ARM_JOINTS], gripper=rows[:, ARM_JOINTS])
