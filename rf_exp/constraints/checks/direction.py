"""Interaction direction (paper, section 3.2): orientation of the gripper when it meets an object.

TCP frame: z points out of the gripper, the fingers close along y.
"""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.check import Evidence, Plans
from rf_exp.constraints.checks.interaction import Contact, ContactCheck, nearest_pose, offset_m
from rf_exp.constraints.phases import span
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, named
from rf_exp.findings import About, CheckName, Finding, agent_name
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

    states, name, unit = Direction, CheckName.DIRECTION, "deg"
    finding, bounds = Finding.OFF_DIRECTION, (ANGLE_DEG, ANGLE_MEASURED_DEG)

    orientation: str  # one of ORIENTATIONS
    text: str = ""
    phase: Step | None = None  # in which it has to hold; at contact unless given

    @classmethod
    def compiled(cls, stated: Direction, plans: Plans) -> "DirectionCheck":
        verb, phase = stated.verb, None
        if verb is not None and VERBS[verb].is_contact:
            planned = {each.verb for each in plans.contacts(stated.agent, stated.object)}
            if planned and verb not in planned:
                raise plans.no_subgoal(f"{agent_name(stated.agent)}: {verb} {stated.object}", stated.agent)
        elif verb is not None:
            phase = plans.step(Step(stated.agent, verb, stated.object))
        return cls(stated.agent, stated.object, stated.direction, stated.sentence, phase)

    def __repr__(self) -> str:
        when = f", {self.phase.verb}" if self.phase else ""
        return f"VD({agent_name(self.agent)}, {self.object}, {self.orientation}{when})"

    def planned(self, plan: Plan) -> Evidence:
        if self.phase is not None:
            return self._throughout(plan, self.phase)
        contact = self.contact(plan)
        if contact is None:
            segments = plan.trajectory(self.agent).segments
            if any(each.subgoal.target == self.object for each in segments):  # with an object in the gripper
                return self.idle(plan, ANGLE_DEG)
            return self.no_contact(plan, Finding.NO_DIRECTION, self.orientation, OPPOSITE_DEG)
        point, pose = self._point(plan, contact), contact.object_pose(plan, self.object)
        off_rad = self._off_rad(contact.tcp(plan), pose, point)
        return self._turned(off_rad, plan.time_s(self.agent, contact.end))

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        point = None
        if self.phase is not None:
            part = span(self.phase, plan.trajectory(self.agent))
            if part is None or not part[0] < plan.position_now(self.agent, scene) <= part[1]:
                return None
        else:
            contact = self.contact_now(plan, scene)
            if contact is None:
                return None
            point = self._point(plan, contact)
        off_rad = self._off_rad(plan.tcp(self.agent, scene), scene.poses[self.object], point)
        return self._turned(off_rad, scene.time_s, measured=True)

    def _throughout(self, plan: Plan, phase: Step) -> Evidence:
        trajectory = plan.trajectory(self.agent)
        part = span(phase, trajectory)
        if part is None:
            return self.idle(plan, ANGLE_DEG)
        tcp = plan.task.arms[self.agent].tcp(trajectory.path()[part[0] : part[1] + 1])
        off_rad = np.array([self._off_rad(each, plan.scene.poses[self.object], None) for each in tcp])
        worst = self.worst(np.degrees(off_rad))
        return self._turned(off_rad[worst], plan.time_s(self.agent, part[0] + worst))

    def _point(self, plan: Plan, contact: Contact) -> InteractionPoint | None:
        points, named = plan.task.asset(self.object).points, contact.segment.subgoal.point
        if named is not None and named in points:
            return points[named]
        tcp, pose = contact.tcp(plan), contact.object_pose(plan, self.object)
        met = [point for point in points.values() if point.kind in ("grasp", "press", "shut")]
        return min(met, key=lambda point: offset_m(tcp, nearest_pose(tcp, pose, point)), default=None)

    def _turned(self, off_rad: float, time_s: float, measured: bool = False) -> Evidence:
        about: About = {"measured": measured, "object": self.object, "aspect": ORIENTATIONS[self.orientation]}
        return self.judged(float(np.degrees(off_rad)), time_s, **about)

    def _off_rad(self, tcp: Matrix, pose: Matrix, point: InteractionPoint | None) -> float:
        approach, fingers = tcp[:3, 2], tcp[:3, 1]
        if self.orientation == "vertical":
            return np.pi - angle_between_rad(approach, UP)
        if self.orientation == "horizontal":
            return abs(np.pi / 2 - angle_between_rad(approach, UP))
        if self.orientation == "level":
            return abs(np.pi / 2 - angle_between_rad(fingers, UP))
        if point is None:  # no annotated point: down onto the object's top
            return np.pi - angle_between_rad(approach, pose[:3, 2])
        found = []
        for annotated in (pose @ alike for alike in point.alike):
            across = min(
                angle_between_rad(fingers, annotated[:3, :2] @ (-np.sin(turn), np.cos(turn)))
                for turn in np.linspace(0.0, 2 * np.pi, point.turns, endpoint=False)
            )
            tilt = angle_between_rad(approach, annotated[:3, 2])
            found.append(max(tilt - np.deg2rad(point.tip_deg), across, 0.0))
        return min(found)

    def stl(self, task: Task) -> Specification:
        phase = (self.phase.verb or "all",) if self.phase else ()
        about, who = (self.agent, self.object, self.orientation, *phase), agent_name(self.agent)
        how = f"angle of the measured gripper of {who} off {self.orientation}"
        met = f"{who} has made contact with {self.object} in this control step"
        judged = named("judged_angle", *about), f"{self.phase.text} goes on" if self.phase else met
        return self.formula(named("angle", *about), how, judged)
