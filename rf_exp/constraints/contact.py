"""Where a plan makes an arm meet an object, and what that is compared with."""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.evidence import Evidence, OneAgentCheck
from rf_exp.constraints.plan import Plan
from rf_exp.findings import Finding
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, Segment

CONTACT = ("approach", "press")  # primitives that end in contact


@dataclass(frozen=True)
class Contact:
    """Where a trajectory meets an object."""

    segment: Segment
    end: int  # path position at contact
    settled: int  # path position at which the fingers have closed

    def tcp(self, plan: Plan) -> Matrix:
        """world_from_tcp as planned."""
        return plan.arm(self.segment.agent).tcp(self.segment.qpos[-1])

    def object_pose(self, plan: Plan, name: str) -> Matrix:
        """world_from_object: where it stands, or where another agent leaves it, whichever is met."""
        poses = [plan.scene.poses[name]]
        for trajectory in plan.trajectories:
            carrying = [segment for segment in trajectory.segments if segment.attached == name]
            if trajectory.agent != self.segment.agent and carrying:
                poses.append(plan.carried(carrying[-1], carrying[-1].qpos[-1]))
        tcp = self.tcp(plan)
        point = plan.task.asset(name).points.get(self.segment.subgoal.point or "")
        at = np.eye(4) if point is None else point.object_from_tcp
        return min(poses, key=lambda pose: offset_m(tcp, pose @ at))


def last_contact(plan: Plan, agent: int, name: str) -> Contact | None:
    """The last contact that the plan of an agent makes with an object."""
    parts, found = list(plan.trajectory(agent).intervals), None
    for index, (segment, _, end) in enumerate(parts):
        if segment.primitive in CONTACT and segment.subgoal.object == name:
            closed = [stop for each, _, stop in parts[index + 1 : index + 2] if each.primitive == "close"]
            found = Contact(segment, end, closed[0] if closed else end)
    return found


def offset_m(a: Matrix, b: Matrix) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))


def no_contact(
    check: OneAgentCheck, plan: Plan, name: str, missed: Finding, aspect: str, value: float, bound: float
) -> Evidence:
    """What it means that an agent makes no contact: it holds the object already, or misses the demand."""
    holds = plan.scene.held[check.agent - 1] == name
    moving = tuple(dict.fromkeys(each.subgoal.text for each in plan.trajectory(check.agent).segments))
    finding, value = (Finding.HOLDS_IT, 0.0) if holds else (missed, value)
    return check.found(
        holds, finding, value, bound, plan.begins_s, object=name, aspect=aspect, subgoals=moving
    )


def nearest_point(plan: Plan, name: str, tcp: Matrix, pose: Matrix) -> InteractionPoint | None:
    points = [point for point in plan.task.asset(name).points.values() if point.kind in ("grasp", "press")]
    return min(points, key=lambda point: offset_m(tcp, pose @ point.object_from_tcp), default=None)


def contact_now(plan: Plan, agent: int, name: str, scene: Scene) -> Contact | None:
    """The last contact of an agent with an object, in the control step in which its fingers have closed."""
    contact = last_contact(plan, agent, name)
    if contact is None:
        return None
    settles = int(np.searchsorted(plan.positions(agent), contact.settled))
    return contact if scene.step - plan.scene.step == settles else None
