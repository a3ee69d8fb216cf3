"""Logical constraints: interaction position and interaction direction (paper, section 3.2).

`ValidateInteraction` and `ValidateDirection` compare the tool centre point (TCP) at contact with the
annotated interaction points of the asset; `ConsistentHeight` is the direction check of two agents that
carry one thing. TCP frame: z points out of the hand, y along the fingers.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.temporal import span
from rf_exp.findings import CheckName, Finding, agent_name, names
from rf_exp.statements import Step
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, angle_between_rad
from rf_exp.types import CONTROL_DT_S, Kind, Scene, Segment

PLACES = ("place", "drop")  # kinds of interaction points at which something is let go
CONTACT = ("approach", "press")  # primitives that end in contact
POSITION_M = 0.01  # of the TCP from the interaction point, planned
POSITION_MEASURED_M = 0.03  # fingers shift what they close on
ANGLE_DEG = 10.0
ANGLE_MEASURED_DEG = 20.0
OPPOSITE_DEG = 180.0  # the value of a direction that is never taken up
HEIGHT_M = 0.02
HEIGHT_MEASURED_M = 0.03
UP = (0.0, 0.0, 1.0)

# word -> what has to be in line
ORIENTATIONS = {
    "perpendicular": "the annotated direction",
    "vertical": "the vertical, pointing down",
    "horizontal": "the horizontal",
    "level": "level fingers",
}


@dataclass(frozen=True)
class _Contact:
    """Where a trajectory meets an object."""

    segment: Segment
    end: int  # path position at contact
    settled: int  # path position at which the fingers have closed

    def tcp(self, plan: Plan) -> Matrix:
        """world_from_tcp as planned."""
        return plan.bodies.arms[self.segment.agent - 1].tcp(self.segment.qpos[-1])

    def object_pose(self, plan: Plan, name: str) -> Matrix:
        """world_from_object: where it stands, or where another agent leaves it, whichever is met."""
        poses = [plan.scene.poses[name]]
        for trajectory in plan.trajectories:
            arm = plan.bodies.arms[trajectory.agent - 1]
            carrying = [segment for segment in trajectory.segments if segment.carries == name]
            if trajectory.agent != self.segment.agent and carrying:
                assert carrying[-1].tcp_from_object is not None  # Bodies.along has refused it otherwise
                poses.append(arm.tcp(carrying[-1].qpos[-1]) @ carrying[-1].tcp_from_object)
        tcp = self.tcp(plan)
        point = plan.task.asset(name).points.get(self.segment.subgoal.point or "")
        at = np.eye(4) if point is None else point.object_from_tcp
        return min(poses, key=lambda pose: _offset_m(tcp, pose @ at))


def _contact(plan: Plan, agent: int, name: str) -> _Contact | None:
    """The last contact that the plan of an agent makes with an object."""
    trajectory = plan.trajectory(agent)
    found: _Contact | None = None
    ends = trajectory.knots[1:]
    for index, (segment, end) in enumerate(zip(trajectory.segments, ends, strict=True)):
        if segment.primitive in CONTACT and segment.subgoal.object == name:
            following = trajectory.segments[index + 1 : index + 2]
            closes = bool(following) and following[0].primitive == "close"
            found = _Contact(segment, end, ends[index + 1] if closes else end)
    return found


def _offset_m(a: Matrix, b: Matrix) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))


def _no_contact(
    plan: Plan, agent: int, name: str, found: Finding, aspect: str, value: float, bound: float
) -> Evidence:
    """What it means that an agent makes no contact: it holds the object already, or misses the demand."""
    holds = plan.scene.held[agent - 1] == name
    moving = dict.fromkeys(each.subgoal.text for each in plan.trajectory(agent).segments)
    return Evidence(
        ok=holds,
        finding=Finding.HOLDS_IT if holds else found,
        value=0.0 if holds else value,
        bound=bound,
        time_s=plan.begins_s,
        agents=(agent,),
        object=name,
        aspect=aspect,
        subgoals=tuple(moving),
    )


def _nearest_point(plan: Plan, name: str, tcp: Matrix, pose: Matrix) -> InteractionPoint | None:
    points = [point for point in plan.task.asset(name).points.values() if point.kind in ("grasp", "press")]
    return min(points, key=lambda point: _offset_m(tcp, pose @ point.object_from_tcp), default=None)


def _settles_now(plan: Plan, agent: int, scene: Scene, position: int) -> bool:
    """Whether this is the control step at which the agent arrives at a path position."""
    return scene.step - plan.scene.step == int(np.searchsorted(plan.positions(agent), position))


@dataclass(frozen=True)
class ValidateInteraction:
    """The agent meets the object at the annotated point. Value and bound in metres."""

    kind: ClassVar[Kind] = "logical"
    name: ClassVar[CheckName] = CheckName.INTERACTION
    unit: ClassVar[str] = "m"

    agent: int
    object: str
    point: str
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.object}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        if plan.task.asset(self.object).points[self.point].kind in PLACES:
            return self._placed(plan)
        contact = _contact(plan, self.agent, self.object)
        if contact is None:
            missed = Finding.NO_CONTACT, self.point, self._nearest_m(plan), POSITION_M
            return _no_contact(plan, self.agent, self.object, *missed)
        time_s = plan.time_s(self.agent, contact.end)
        pose = contact.object_pose(plan, self.object)
        return self._evidence(plan, contact.tcp(plan), pose, POSITION_M, time_s, False)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if plan.task.asset(self.object).points[self.point].kind in PLACES:
            return None
        contact = _contact(plan, self.agent, self.object)
        if contact is None or not _settles_now(plan, self.agent, scene, contact.settled):
            return None
        tcp = plan.bodies.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        time_s = scene.step * CONTROL_DT_S
        return self._evidence(plan, tcp, scene.poses[self.object], POSITION_MEASURED_M, time_s, True)

    def _evidence(
        self, plan: Plan, tcp: Matrix, pose: Matrix, bound_m: float, time_s: float, measured: bool
    ) -> Evidence:
        point = plan.task.asset(self.object).points[self.point]
        value = _offset_m(tcp, pose @ point.object_from_tcp)
        return Evidence(
            ok=value <= bound_m,
            finding=Finding.BESIDE_POINT,
            value=value,
            bound=bound_m,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            object=self.object,
            aspect=self.point,
        )

    def _nearest_m(self, plan: Plan) -> float:
        """How near the TCP comes to the point where it is now."""
        tcp = plan.bodies.arms[self.agent - 1].tcp(plan.trajectory(self.agent).path())  # (P, 4, 4)
        point = (
            plan.scene.poses[self.object] @ plan.task.asset(self.object).points[self.point].object_from_tcp
        )
        return float(np.linalg.norm(tcp[:, :3, 3] - point[:3, 3], axis=1).min())

    def _placed(self, plan: Plan) -> Evidence:
        """A place point: where what the agent carries is let go. Counted on the level."""
        point = plan.task.asset(self.object).points[self.point]
        bound_m = point.slack_m + POSITION_M
        trajectory, arm = plan.trajectory(self.agent), plan.bodies.arms[self.agent - 1]
        worst = idle(plan, self.agents, bound=bound_m)
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            if segment.subgoal.target == self.object and segment.primitive == "lower":
                assert segment.tcp_from_object is not None  # Bodies.along has refused it otherwise
                placed = arm.tcp(segment.qpos[-1]) @ segment.tcp_from_object
                goal = plan.scene.poses[self.object] @ point.object_from_tcp
                value = float(np.linalg.norm(placed[:2, 3] - goal[:2, 3]))
                worst = Evidence(
                    ok=value <= bound_m,
                    finding=Finding.PUT_BESIDE_POINT,
                    value=value,
                    bound=bound_m,
                    time_s=plan.time_s(self.agent, end),
                    agents=self.agents,
                    object=segment.carries,
                    aspect=f"{self.point} point of {self.object}",
                )
        return worst


@dataclass(frozen=True)
class ValidateDirection:
    """The gripper has the required orientation at contact. Value and bound in degrees.

    `perpendicular` asks for the annotated direction of the interaction point: both the approach
    and the axis along which the fingers close, within the turns and the tip that the point allows.
    """

    kind: ClassVar[Kind] = "logical"
    name: ClassVar[CheckName] = CheckName.DIRECTION
    unit: ClassVar[str] = "deg"

    agent: int
    object: str
    orientation: str  # one of ORIENTATIONS
    text: str = ""
    phase: Step | None = None  # in which it has to hold; at contact unless given

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def __repr__(self) -> str:
        when = f", {self.phase.verb}" if self.phase else ""
        return f"VD({agent_name(self.agent)}, {self.object}, {self.orientation}{when})"

    def planned(self, plan: Plan) -> Evidence:
        if self.phase is not None:
            return self._throughout(plan, self.phase)
        contact = _contact(plan, self.agent, self.object)
        if contact is None and self._is_target(plan):
            return idle(plan, self.agents, bound=ANGLE_DEG)
        if contact is None:
            missed = Finding.NO_DIRECTION, self.orientation, OPPOSITE_DEG, ANGLE_DEG
            return _no_contact(plan, self.agent, self.object, *missed)
        point, pose = self._point(plan, contact), contact.object_pose(plan, self.object)
        time_s = plan.time_s(self.agent, contact.end)
        return self._evidence(contact.tcp(plan), pose, point, ANGLE_DEG, time_s, False)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        tcp = plan.bodies.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        pose, now_s = scene.poses[self.object], scene.step * CONTROL_DT_S
        if self.phase is not None:
            part = span(self.phase, plan.trajectory(self.agent))
            if part is None or not part[0] < plan.position_now(self.agent, scene) <= part[1]:
                return None
            return self._evidence(tcp, pose, None, ANGLE_MEASURED_DEG, now_s, True)
        contact = _contact(plan, self.agent, self.object)
        if contact is None or not _settles_now(plan, self.agent, scene, contact.settled):
            return None
        return self._evidence(tcp, pose, self._point(plan, contact), ANGLE_MEASURED_DEG, now_s, True)

    def _throughout(self, plan: Plan, phase: Step) -> Evidence:
        """The worst moment of a phase."""
        trajectory = plan.trajectory(self.agent)
        part = span(phase, trajectory)
        if part is None:
            return idle(plan, self.agents, bound=ANGLE_DEG)
        tcp = plan.bodies.arms[self.agent - 1].tcp(trajectory.path()[part[0] : part[1] + 1])
        pose = plan.scene.poses[self.object]
        found = [
            self._evidence(each, pose, None, ANGLE_DEG, plan.time_s(self.agent, part[0] + row), False)
            for row, each in enumerate(tcp)
        ]
        return max(found, key=lambda evidence: evidence.value)

    def _is_target(self, plan: Plan) -> bool:
        """Whether the agent goes to the object with something in its hand."""
        return any(each.subgoal.target == self.object for each in plan.trajectory(self.agent).segments)

    def _point(self, plan: Plan, contact: _Contact) -> InteractionPoint | None:
        points, named = plan.task.asset(self.object).points, contact.segment.subgoal.point
        if named is not None and named in points:
            return points[named]
        return _nearest_point(plan, self.object, contact.tcp(plan), contact.object_pose(plan, self.object))

    def _evidence(
        self,
        tcp: Matrix,
        pose: Matrix,
        point: InteractionPoint | None,
        bound_deg: float,
        time_s: float,
        measured: bool,
    ) -> Evidence:
        value = float(np.degrees(self._error_rad(tcp, pose, point)))
        return Evidence(
            ok=value <= bound_deg,
            finding=Finding.OFF_DIRECTION,
            value=value,
            bound=bound_deg,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            object=self.object,
            aspect=ORIENTATIONS[self.orientation],
        )

    def _error_rad(self, tcp: Matrix, pose: Matrix, point: InteractionPoint | None) -> float:
        approach, fingers = tcp[:3, 2], tcp[:3, 1]
        if self.orientation == "vertical":
            return np.pi - angle_between_rad(approach, UP)
        if self.orientation == "horizontal":
            return abs(np.pi / 2 - angle_between_rad(approach, UP))
        if self.orientation == "level":
            return abs(np.pi / 2 - angle_between_rad(fingers, UP))
        if point is None:  # nothing annotated: down onto its top
            return np.pi - angle_between_rad(approach, pose[:3, 2])
        annotated = pose @ point.object_from_tcp
        across = min(
            angle_between_rad(fingers, annotated[:3, :2] @ (-np.sin(turn), np.cos(turn)))
            for turn in np.linspace(0.0, 2 * np.pi, point.turns, endpoint=False)
        )
        tilt = angle_between_rad(approach, annotated[:3, 2])
        return max(tilt - np.deg2rad(point.tip_deg), across, 0.0)


@dataclass(frozen=True)
class ConsistentHeight:
    """Agents that carry one thing together raise it by the same height. Value and bound in metres.

    With a model of time at every control step of the schedule, otherwise at the end of the plan. With a
    `phase` (of each agent) only there.
    """

    kind: ClassVar[Kind] = "logical"
    name: ClassVar[CheckName] = CheckName.DIRECTION
    unit: ClassVar[str] = "m"

    agents: tuple[int, ...]
    text: str = ""
    phase: tuple[Step, ...] = ()

    def __repr__(self) -> str:
        when = f", {self.phase[0].verb}" if self.phase else ""
        return f"VD({names(self.agents)}, consistent height{when})"

    def planned(self, plan: Plan) -> Evidence:
        worst = idle(plan, self.agents, bound=HEIGHT_M)
        for name in self._together(plan):
            rises = np.stack([self._rise_m(plan, agent, name) for agent in self.agents])  # (agents, T + 1)
            spread = np.ptp(rises, axis=0)
            at = int(np.argmax(spread))
            if spread[at] >= worst.value:
                time_s = plan.begins_s + (at * CONTROL_DT_S if plan.row.temporal else 0.0)
                worst = self._evidence(name, float(spread[at]), HEIGHT_M, time_s, False)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        held = {scene.held[agent - 1] for agent in self.agents}
        name = next(iter(held))
        if not plan.row.temporal or len(held) != 1 or name is None or name not in self._together(plan):
            return None
        rises = []
        for agent in self.agents:
            begin, end = self._span(plan, agent, name)
            now = plan.position_now(agent, scene)
            if now <= begin or (self.phase and now > end):
                return None
            arm = plan.bodies.arms[agent - 1]
            rises.append(
                arm.tcp(scene.qpos[agent - 1])[2, 3] - arm.tcp(plan.trajectory(agent).path()[begin])[2, 3]
            )
        return self._evidence(name, float(np.ptp(rises)), HEIGHT_MEASURED_M, scene.step * CONTROL_DT_S, True)

    def _together(self, plan: Plan) -> list[str]:
        """The things that all of them carry in this plan."""
        carried = [
            {segment.carries for segment in plan.trajectory(agent).segments} - {None} for agent in self.agents
        ]
        return sorted(name for name in set.intersection(*carried) if name)

    def _span(self, plan: Plan, agent: int, name: str) -> tuple[int, int]:
        """Path positions between which an agent carries a thing and has to keep level with the others."""
        begin, end = _carried(plan, agent, name)
        for step in self.phase:
            if step.agent == agent and (part := span(step, plan.trajectory(agent))) is not None:
                return max(begin, part[0]), max(begin, min(end, part[1]))
        return begin, end

    def _rise_m(self, plan: Plan, agent: int, name: str) -> NDArray[np.float64]:
        """How far an agent has raised a thing: (T + 1,), or (1,) at the end without a model of time."""
        trajectory = plan.trajectory(agent)
        height = plan.bodies.arms[agent - 1].tcp(trajectory.path())[:, 2, 3]
        positions = plan.positions(agent) if plan.row.temporal else np.array([len(trajectory)])
        begin, end = self._span(plan, agent, name)
        return height[np.clip(positions, begin, end)] - height[begin]

    def _evidence(self, name: str, value: float, bound_m: float, time_s: float, measured: bool) -> Evidence:
        return Evidence(
            ok=value <= bound_m,
            finding=Finding.UNEVEN,
            value=value,
            bound=bound_m,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            object=name,
        )


def _carried(plan: Plan, agent: int, name: str) -> tuple[int, int]:
    """Path positions between which an agent carries a thing, for the first time."""
    trajectory = plan.trajectory(agent)
    begin = end = None
    for segment, start, stop in zip(
        trajectory.segments, trajectory.knots[:-1], trajectory.knots[1:], strict=True
    ):
        if segment.carries == name:
            begin, end = start if begin is None else begin, stop
        elif begin is not None:
            break
    assert begin is not None and end is not None  # asked of what is carried only
    return begin, end
