"""Interaction position (paper, section 3.2): where a gripper meets an object, and where it puts one.

The tool centre point (TCP) is compared with the annotated interaction points of the asset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck, Plans
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Execution, Signal, Specification, always, condition, named
from rf_exp.findings import About, CheckName, Finding, agent_name
from rf_exp.statements import ContactAt, PlaceAt
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, Segment

POSITION_M = 0.01  # of the TCP from the interaction point, planned
POSITION_MEASURED_M = 0.03  # closing fingers shift the object
# A press continues until contact is felt, which is farther on where measured joints are wrong: up to the
# latter this does not count as offset. Less than the former is inverse kinematics, not intent.
FARTHER_M = (0.001, 0.02)
CONTACT = ("approach", "press")  # primitives that end in contact


@dataclass(frozen=True)
class Contact:
    """Contact of a trajectory with an object."""

    segment: Segment
    end: int  # path position at contact
    settled: int  # path position at which the fingers have closed

    def tcp(self, plan: Plan) -> Matrix:
        """world_from_tcp as planned."""
        return plan.task.arms[self.segment.agent].tcp(self.segment.qpos[-1])

    def object_pose(self, plan: Plan, name: str) -> Matrix:
        """world_from_object now, or where another agent leaves it, whichever is nearer to the contact."""
        poses = [plan.scene.poses[name]]
        for trajectory in plan.trajectories:
            carrying = [segment for segment in trajectory.segments if segment.attached == name]
            if trajectory.agent != self.segment.agent and carrying:
                poses.append(plan.carried(carrying[-1], -1))
        tcp = self.tcp(plan)
        point = plan.task.asset(name).points.get(self.segment.subgoal.point or "")
        if point is None:
            return min(poses, key=lambda pose: offset_m(tcp, pose))
        return min(poses, key=lambda pose: offset_m(tcp, nearest_pose(tcp, pose, point)))


def offset_m(a: Matrix, b: Matrix) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))


def nearest_pose(tcp: Matrix, world_from_object: Matrix, point: InteractionPoint) -> Matrix:
    """world_from_tcp at a point of an object: of its equivalent poses the nearest to a gripper."""
    return min((world_from_object @ alike for alike in point.alike), key=lambda pose: offset_m(tcp, pose))


@dataclass(frozen=True)
class ContactCheck(OneAgentCheck, BoundedCheck):
    """A check of an agent's contact with an object."""

    object: str

    def contact(self, plan: Plan) -> Contact | None:
        """The last contact with the object in the agent's plan; None without one."""
        parts, found = list(plan.trajectory(self.agent).intervals), None
        for index, (segment, _, end) in enumerate(parts):
            if segment.primitive in CONTACT and segment.subgoal.object == self.object:
                closed = [stop for each, _, stop in parts[index + 1 : index + 2] if each.primitive == "close"]
                found = Contact(segment, end, closed[0] if closed else end)
        return found

    def contact_now(self, plan: Plan, scene: Scene) -> Contact | None:
        """The same, at the control step at which the fingers have closed; None at others."""
        contact = self.contact(plan)
        if contact is None:
            return None
        settles = int(np.searchsorted(plan.positions(self.agent), contact.settled))
        return contact if scene.step - plan.scene.step == settles else None

    def no_contact(self, plan: Plan, missed: Finding, aspect: str, value: float) -> Evidence:
        """Evidence without a contact: the agent holds the object already, or violates the constraint."""
        holds = plan.scene.held[self.agent - 1] == self.object
        moving = tuple(dict.fromkeys(each.subgoal.text for each in plan.trajectory(self.agent).segments))
        about: About = {"object": self.object, "aspect": aspect, "subgoals": moving}
        finding, value = (Finding.HOLDS_IT, 0.0) if holds else (missed, value)
        return self.found(holds, finding, value, self.bounds[False], plan.begins_s, **about)


@dataclass(frozen=True)
class ContactAtCheck(ContactCheck):
    """The agent meets the object at the annotated point. Value and bound in metres."""

    states, name, unit = ContactAt, CheckName.INTERACTION, "m"
    finding, bounds = Finding.BESIDE_POINT, (POSITION_M, POSITION_MEASURED_M)

    point: str
    text: str = ""

    @classmethod
    def compiled(cls, stated: ContactAt, plans: Plans) -> "ContactAtCheck":
        planned = {each.point for each in plans.contacts(stated.agent, stated.object) if each.point}
        if planned and stated.point not in planned:
            raise plans.refused(
                f"demands point {stated.point}, but {agent_name(stated.agent)} is to meet {stated.object} at "
                f"{' and '.join(sorted(planned))}; change the subgoal or the constraint"
            )
        return super().compiled(stated, plans)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.object}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        contact = self.contact(plan)
        if contact is None:
            point = plan.task.asset(self.object).points[self.point]
            met_m = np.stack([(plan.scene.poses[self.object] @ alike)[:3, 3] for alike in point.alike])
            grippers_m = plan.paths.grippers_m(self.agent)[:, None]
            nearest_m = float(np.linalg.norm(grippers_m - met_m, axis=-1).min())
            return self.no_contact(plan, Finding.NO_CONTACT, self.point, nearest_m)
        pose, time_s = contact.object_pose(plan, self.object), plan.time_s(self.agent, contact.end)
        return self._beside(plan, contact.tcp(plan), pose, time_s)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if self.contact_now(plan, scene) is None:
            return None
        tcp, pose = plan.tcp(self.agent, scene), scene.poses[self.object]
        return self._beside(plan, tcp, pose, scene.time_s, measured=True)

    def _beside(
        self, plan: Plan, tcp: Matrix, pose: Matrix, time_s: float, measured: bool = False
    ) -> Evidence:
        point = plan.task.asset(self.object).points[self.point]
        pose = nearest_pose(tcp, pose, point)
        off_m = tcp[:3, 3] - pose[:3, 3]
        farther_m = float(off_m @ pose[:3, 2])
        if point.kind == "press" and farther_m > FARTHER_M[0]:
            off_m = off_m - min(farther_m, FARTHER_M[1]) * pose[:3, 2]
        value = float(np.linalg.norm(off_m))
        return self.judged(value, time_s, measured=measured, object=self.object, aspect=self.point)

    def stl(self, task: Task) -> Specification:
        about, who = (self.agent, self.object, self.point), agent_name(self.agent)
        how = f"from the measured gripper of {who} to point {self.point} of {self.object}"
        when = f"{who} has made contact with {self.object} in this control step"
        return self.formula(named("offset", *about), how, (named("meets", *about), when))


@dataclass(frozen=True)
class PlaceAtCheck(OneAgentCheck):
    """The agent releases its object at the annotated point of a target: horizontal distance in metres.

    Judged before execution, by the planned place of release.
    """

    states, name, unit = PlaceAt, CheckName.INTERACTION, "m"

    target: str
    point: str
    text: str = ""

    @classmethod
    def compiled(cls, stated: PlaceAt, plans: Plans) -> "PlaceAtCheck":
        plans.place(stated.agent, stated.object, stated.target)
        return cls(stated.agent, stated.target, stated.point, stated.sentence)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.target}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        point = plan.task.asset(self.target).points[self.point]
        bound_m = point.slack_m + POSITION_M
        found, goal = self.idle(plan, bound_m), plan.scene.poses[self.target] @ point.object_from_tcp
        for segment, _, end in plan.trajectory(self.agent).intervals:
            if segment.subgoal.target == self.target and segment.primitive == "lower":
                placed = plan.carried(segment, -1)
                value, time_s = float(np.linalg.norm((placed - goal)[:2, 3])), plan.time_s(self.agent, end)
                about: About = {"object": segment.attached, "aspect": f"{self.point} point of {self.target}"}
                ok = value <= bound_m
                found = self.found(ok, Finding.PUT_BESIDE_POINT, value, bound_m, time_s, **about)
        return found

    def stl(self, task: Task) -> Specification:
        about, who = (self.agent, self.target, self.point), agent_name(self.agent)

        def ends(execution: Execution) -> NDArray[np.float64]:
            evidence = self.planned(execution.plan)
            moment_s = execution.plan.begins_s + execution.clock_s
            return condition(np.isclose(moment_s, evidence.time_s) & (evidence.time_s > 0))

        def beside_m(execution: Execution) -> NDArray[np.float64]:
            return np.full(len(execution), self.planned(execution.plan).value)

        how = f"on the level, from what {who} puts down, as commanded, to point {self.point}"
        offset = Signal(named("beside", *about), "m", how, beside_m)
        when = "the commanded motion that puts it down ends in this control step"
        puts = Signal(named("puts", *about), "", when, ends)
        bound_m = task.asset(self.target).points[self.point].slack_m + POSITION_M
        formula = always([f"{offset.name} <= {bound_m!r}"], "m", puts)
        return Specification((formula,), (offset, puts), measured=False)
