"""Interaction position (paper, section 3.2): where a gripper meets an object, and where it puts one.

The tool centre point (TCP) is compared with the annotated interaction points of the asset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck, PlanContext
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Execution, Signal, Specification, always, condition_values, identifier
from rf_exp.findings import CheckName, FactArguments, Finding, agent_name
from rf_exp.statements import ContactAt, PlaceAt
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, Segment

POSITION_M = 0.01  # of the TCP from the interaction point, planned
POSITION_MEASURED_M = 0.03  # closing fingers shift the object
# A press continues until contact is felt, which is farther on where measured joints are wrong: up to the
# latter this does not count as offset. Less than the former is inverse kinematics, not intent.
PRESS_DEPTH_M = (0.001, 0.02)
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
            carrying_segments = [segment for segment in trajectory.segments if segment.attached == name]
            if trajectory.agent != self.segment.agent and carrying_segments:
                poses.append(plan.attached_object_poses(carrying_segments[-1], -1))
        tcp = self.tcp(plan)
        point = plan.task.asset(name).points.get(self.segment.subgoal.point or "")
        if point is None:
            return min(poses, key=lambda pose: offset_m(tcp, pose))
        return min(poses, key=lambda pose: offset_m(tcp, nearest_pose(tcp, pose, point)))


def offset_m(a: Matrix, b: Matrix) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))


def nearest_pose(tcp: Matrix, world_from_object: Matrix, point: InteractionPoint) -> Matrix:
    """world_from_tcp at a point of an object: of its equivalent poses the nearest to a gripper."""
    return min(
        (world_from_object @ equivalent for equivalent in point.equivalent_poses),
        key=lambda pose: offset_m(tcp, pose),
    )


@dataclass(frozen=True)
class ContactCheck(OneAgentCheck, BoundedCheck):
    """A check of an agent's contact with an object."""

    object: str

    def contact(self, plan: Plan) -> Contact | None:
        """The last contact with the object in the agent's plan; None without one."""
        intervals, contact = list(plan.trajectory(self.agent).intervals), None
        for index, (segment, _, end) in enumerate(intervals):
            if segment.primitive in CONTACT and segment.subgoal.object == self.object:
                closing_ends = [
                    close_end
                    for following, _, close_end in intervals[index + 1 : index + 2]
                    if following.primitive == "close"
                ]
                contact = Contact(segment, end, closing_ends[0] if closing_ends else end)
        return contact

    def contact_in_step(self, plan: Plan, scene: Scene) -> Contact | None:
        """The same, at the control step at which the fingers have closed; None at others."""
        contact = self.contact(plan)
        if contact is None:
            return None
        settles = int(np.searchsorted(plan.positions(self.agent), contact.settled))
        return contact if scene.step - plan.scene.step == settles else None

    def no_contact_evidence(self, plan: Plan, missed: Finding, aspect: str, value: float) -> Evidence:
        """Evidence without a contact: the agent holds the object already, or violates the constraint."""
        is_held = plan.scene.held[self.agent - 1] == self.object
        subgoals = tuple(
            dict.fromkeys(segment.subgoal.text for segment in plan.trajectory(self.agent).segments)
        )
        facts: FactArguments = {"object": self.object, "aspect": aspect, "subgoals": subgoals}
        finding, value = (Finding.HOLDS_IT, 0.0) if is_held else (missed, value)
        return self.make_evidence(is_held, finding, value, self.bounds[False], plan.begins_s, **facts)


@dataclass(frozen=True)
class ContactAtCheck(ContactCheck):
    """The agent meets the object at the annotated point. Value and bound in metres."""

    statement_type, name, unit = ContactAt, CheckName.INTERACTION, "m"
    finding, bounds = Finding.BESIDE_POINT, (POSITION_M, POSITION_MEASURED_M)

    point: str
    text: str = ""

    @classmethod
    def from_statement(cls, statement: ContactAt, context: PlanContext) -> "ContactAtCheck":
        planned_points = {
            subgoal.point
            for subgoal in context.contact_subgoals(statement.agent, statement.object)
            if subgoal.point
        }
        if planned_points and statement.point not in planned_points:
            raise context.error(
                f"demands point {statement.point}, but {agent_name(statement.agent)} is to meet "
                f"{statement.object} at {' and '.join(sorted(planned_points))}; change the subgoal or the "
                "constraint"
            )
        return super().from_statement(statement, context)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.object}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        contact = self.contact(plan)
        if contact is None:
            point = plan.task.asset(self.object).points[self.point]
            points_m = np.stack(
                [(plan.scene.poses[self.object] @ equivalent)[:3, 3] for equivalent in point.equivalent_poses]
            )
            gripper_positions_m = plan.paths.gripper_positions_m(self.agent)[:, None]
            nearest_m = float(np.linalg.norm(gripper_positions_m - points_m, axis=-1).min())
            return self.no_contact_evidence(plan, Finding.NO_CONTACT, self.point, nearest_m)
        pose, time_s = contact.object_pose(plan, self.object), plan.time_s(self.agent, contact.end)
        return self._position_evidence(plan, contact.tcp(plan), pose, time_s)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if self.contact_in_step(plan, scene) is None:
            return None
        tcp, pose = plan.tcp(self.agent, scene), scene.poses[self.object]
        return self._position_evidence(plan, tcp, pose, scene.time_s, measured=True)

    def _position_evidence(
        self, plan: Plan, tcp: Matrix, pose: Matrix, time_s: float, measured: bool = False
    ) -> Evidence:
        point = plan.task.asset(self.object).points[self.point]
        pose = nearest_pose(tcp, pose, point)
        offset = tcp[:3, 3] - pose[:3, 3]
        depth_m = float(offset @ pose[:3, 2])
        if point.kind == "press" and depth_m > PRESS_DEPTH_M[0]:
            offset = offset - min(depth_m, PRESS_DEPTH_M[1]) * pose[:3, 2]
        value = float(np.linalg.norm(offset))
        return self.evidence_for(value, time_s, measured=measured, object=self.object, aspect=self.point)

    def stl(self, task: Task) -> Specification:
        name_parts, agent = (self.agent, self.object, self.point), agent_name(self.agent)
        description = f"from the measured gripper of {agent} to point {self.point} of {self.object}"
        condition = f"{agent} has made contact with {self.object} in this control step"
        return self.formula(
            identifier("offset", *name_parts), description, (identifier("meets", *name_parts), condition)
        )


@dataclass(frozen=True)
class PlaceAtCheck(OneAgentCheck):
    """The agent releases its object at the annotated point of a target: horizontal distance in metres.

    Judged before execution, by the planned place of release.
    """

    statement_type, name, unit = PlaceAt, CheckName.INTERACTION, "m"

    target: str
    point: str
    text: str = ""

    @classmethod
    def from_statement(cls, statement: PlaceAt, context: PlanContext) -> "PlaceAtCheck":
        context.require_place_subgoal(statement.agent, statement.object, statement.target)
        return cls(statement.agent, statement.target, statement.point, statement.sentence)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.target}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        point = plan.task.asset(self.target).points[self.point]
        bound_m = point.slack_m + POSITION_M
        evidence, goal = (
            self.not_applicable(plan, bound_m),
            plan.scene.poses[self.target] @ point.object_from_tcp,
        )
        for segment, _, end in plan.trajectory(self.agent).intervals:
            if segment.subgoal.target == self.target and segment.primitive == "lower":
                placed = plan.attached_object_poses(segment, -1)
                value, time_s = float(np.linalg.norm((placed - goal)[:2, 3])), plan.time_s(self.agent, end)
                facts: FactArguments = {
                    "object": segment.attached,
                    "aspect": f"{self.point} point of {self.target}",
                }
                ok = value <= bound_m
                evidence = self.make_evidence(ok, Finding.PUT_BESIDE_POINT, value, bound_m, time_s, **facts)
        return evidence

    def stl(self, task: Task) -> Specification:
        name_parts, agent = (self.agent, self.target, self.point), agent_name(self.agent)

        def is_ending(execution: Execution) -> NDArray[np.float64]:
            evidence = self.planned(execution.plan)
            time_s = execution.plan.begins_s + execution.clock_s
            return condition_values(np.isclose(time_s, evidence.time_s) & (evidence.time_s > 0))

        def distance_m(execution: Execution) -> NDArray[np.float64]:
            return np.full(len(execution), self.planned(execution.plan).value)

        description = f"on the level, from what {agent} puts down, as commanded, to point {self.point}"
        offset = Signal(identifier("beside", *name_parts), "m", description, distance_m)
        condition = "the commanded motion that puts it down ends in this control step"
        placing = Signal(identifier("puts", *name_parts), "", condition, is_ending)
        bound_m = task.asset(self.target).points[self.point].slack_m + POSITION_M
        formula = always([f"{offset.name} <= {bound_m!r}"], "m", placing)
        return Specification((formula,), (offset, placing), measured=False)
