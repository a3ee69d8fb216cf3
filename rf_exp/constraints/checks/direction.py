"""Interaction direction (paper, section 3.2): orientation of the gripper when it meets an object.

TCP frame: z points out of the gripper, the fingers close along y.
"""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import Evidence, PlanContext
from rf_exp.constraints.checks.interaction import Contact, ContactCheck, nearest_pose, offset_m
from rf_exp.constraints.phases import span
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.findings import CheckName, FactArguments, Finding, agent_name
from rf_exp.statements import VERBS, Direction, Step
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, angle_between_rad
from rf_exp.types import Scene

ANGLE_DEG = 10.0
ANGLE_MEASURED_DEG = 20.0
OPPOSITE_DEG = 180.0  # value without any contact
UP = (0.0, 0.0, 1.0)
# orientation -> its reference, as in sentences
ORIENTATIONS = {
    "perpendicular": "the annotated direction",
    "vertical": "the vertical, pointing down",
    "horizontal": "the horizontal",
    "level": "level fingers",
}


@dataclass(frozen=True)
class DirectionCheck(ContactCheck):
    """The gripper has the required orientation at contact. Value and bound in degrees.

    `perpendicular` requires the annotated direction of the interaction point: both the approach and the axis
    along which the fingers close, up to the turns and the tip that the point allows.
    """

    statement_type, name, unit = Direction, CheckName.DIRECTION, "deg"
    finding, bounds = Finding.OFF_DIRECTION, (ANGLE_DEG, ANGLE_MEASURED_DEG)

    orientation: str  # one of ORIENTATIONS
    text: str = ""
    phase: Step | None = None  # in which it has to hold; at contact unless given

    @classmethod
    def from_statement(cls, statement: Direction, context: PlanContext) -> "DirectionCheck":
        verb, phase = statement.verb, None
        if verb is not None and VERBS[verb].is_contact:
            planned = {
                subgoal.verb for subgoal in context.contact_subgoals(statement.agent, statement.object)
            }
            if planned and verb not in planned:
                raise context.missing_subgoal_error(
                    f"{agent_name(statement.agent)}: {verb} {statement.object}", statement.agent
                )
        elif verb is not None:
            phase = context.step(Step(statement.agent, verb, statement.object))
        return cls(statement.agent, statement.object, statement.direction, statement.sentence, phase)

    def __repr__(self) -> str:
        when = f", {self.phase.verb}" if self.phase else ""
        return f"VD({agent_name(self.agent)}, {self.object}, {self.orientation}{when})"

    def planned(self, plan: Plan) -> Evidence:
        if self.phase is not None:
            return self._phase_evidence(plan, self.phase)
        contact = self.contact(plan)
        if contact is None:
            segments = plan.trajectory(self.agent).segments
            # The object is met by another one in the gripper.
            if any(segment.subgoal.target == self.object for segment in segments):
                return self.not_applicable(plan, ANGLE_DEG)
            return self.no_contact_evidence(plan, Finding.NO_DIRECTION, self.orientation, OPPOSITE_DEG)
        point, pose = self._interaction_point(plan, contact), contact.object_pose(plan, self.object)
        angle_error_rad = self._angle_error_rad(contact.tcp(plan), pose, point)
        return self._direction_evidence(angle_error_rad, plan.time_s(self.agent, contact.end))

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        point = None
        if self.phase is not None:
            part = span(self.phase, plan.trajectory(self.agent))
            if part is None or not part[0] < plan.position_now(self.agent, scene) <= part[1]:
                return None
        else:
            contact = self.contact_in_step(plan, scene)
            if contact is None:
                return None
            point = self._interaction_point(plan, contact)
        angle_error_rad = self._angle_error_rad(plan.tcp(self.agent, scene), scene.poses[self.object], point)
        return self._direction_evidence(angle_error_rad, scene.time_s, measured=True)

    def _phase_evidence(self, plan: Plan, phase: Step) -> Evidence:
        trajectory = plan.trajectory(self.agent)
        part = span(phase, trajectory)
        if part is None:
            return self.not_applicable(plan, ANGLE_DEG)
        tcp = plan.task.arms[self.agent].tcp(trajectory.path()[part[0] : part[1] + 1])
        angle_errors_rad = np.array(
            [self._angle_error_rad(pose, plan.scene.poses[self.object], None) for pose in tcp]
        )
        worst = self.worst(np.degrees(angle_errors_rad))
        return self._direction_evidence(angle_errors_rad[worst], plan.time_s(self.agent, part[0] + worst))

    def _interaction_point(self, plan: Plan, contact: Contact) -> InteractionPoint | None:
        points, name = plan.task.asset(self.object).points, contact.segment.subgoal.point
        if name is not None and name in points:
            return points[name]
        tcp, pose = contact.tcp(plan), contact.object_pose(plan, self.object)
        contact_points = [point for point in points.values() if point.kind in ("grasp", "press", "shut")]
        return min(
            contact_points, key=lambda point: offset_m(tcp, nearest_pose(tcp, pose, point)), default=None
        )

    def _direction_evidence(self, angle_error_rad: float, time_s: float, measured: bool = False) -> Evidence:
        facts: FactArguments = {
            "measured": measured,
            "object": self.object,
            "aspect": ORIENTATIONS[self.orientation],
        }
        return self.evidence_for(float(np.degrees(angle_error_rad)), time_s, **facts)

    def _angle_error_rad(self, tcp: Matrix, pose: Matrix, point: InteractionPoint | None) -> float:
        approach, fingers = tcp[:3, 2], tcp[:3, 1]
        if self.orientation == "vertical":
            return np.pi - angle_between_rad(approach, UP)
        if self.orientation == "horizontal":
            return abs(np.pi / 2 - angle_between_rad(approach, UP))
        if self.orientation == "level":
            return abs(np.pi / 2 - angle_between_rad(fingers, UP))
        if point is None:  # no annotated point: down onto the object's top
            return np.pi - angle_between_rad(approach, pose[:3, 2])
        angles_rad = []
        for annotated in (pose @ equivalent for equivalent in point.equivalent_poses):
            finger_angle_rad = min(
                angle_between_rad(fingers, annotated[:3, :2] @ (-np.sin(turn), np.cos(turn)))
                for turn in np.linspace(0.0, 2 * np.pi, point.turns, endpoint=False)
            )
            approach_angle_rad = angle_between_rad(approach, annotated[:3, 2])
            angles_rad.append(max(approach_angle_rad - np.deg2rad(point.tip_deg), finger_angle_rad, 0.0))
        return min(angles_rad)

    def stl(self, task: Task) -> Specification:
        phase = (self.phase.verb or "all",) if self.phase else ()
        name_parts, agent = (self.agent, self.object, self.orientation, *phase), agent_name(self.agent)
        description = f"angle of the measured gripper of {agent} off {self.orientation}"
        at_contact = f"{agent} has made contact with {self.object} in this control step"
        gate = (
            identifier("judged_angle", *name_parts),
            f"{self.phase.text} goes on" if self.phase else at_contact,
        )
        return self.formula(identifier("angle", *name_parts), description, gate)
