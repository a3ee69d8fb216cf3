"""Interaction position (paper, section 3.2): where an object is met, and where it is put.

The tool centre point (TCP) is compared with the annotated interaction points of the asset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.contact import last_contact, no_contact, offset_m, settles_now
from rf_exp.constraints.evidence import About, Evidence, OneAgentCheck
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import (
    Execution,
    Signal,
    Specification,
    always,
    bounded,
    condition,
    named,
    of_schedule,
)
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.statements import ContactAt, PlaceAt
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_DT_S, Scene

POSITION_M = 0.01  # of the TCP from the interaction point, planned
POSITION_MEASURED_M = 0.03  # fingers shift what they close on


@dataclass(frozen=True)
class ContactAtCheck(OneAgentCheck):
    """The agent meets the object at the annotated point. Value and bound in metres."""

    states, name, unit = ContactAt, CheckName.INTERACTION, "m"

    agent: int
    object: str
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
        return cls(stated.agent, stated.object, stated.point, stated.sentence)

    def __repr__(self) -> str:
        return f"VI({agent_name(self.agent)}, {self.object}, {self.point})"

    def planned(self, plan: Plan) -> Evidence:
        contact = last_contact(plan, self.agent, self.object)
        if contact is None:
            nearest_m = self._nearest_m(plan)
            return no_contact(self, plan, self.object, Finding.NO_CONTACT, self.point, nearest_m, POSITION_M)
        pose, time_s = contact.object_pose(plan, self.object), plan.time_s(self.agent, contact.end)
        return self._beside(plan, contact.tcp(plan), pose, POSITION_M, time_s, False)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        contact = last_contact(plan, self.agent, self.object)
        if contact is None or not settles_now(plan, self.agent, scene, contact.settled):
            return None
        tcp = plan.planning_scene.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        pose, now_s = scene.poses[self.object], scene.step * CONTROL_DT_S
        return self._beside(plan, tcp, pose, POSITION_MEASURED_M, now_s, True)

    def _beside(
        self, plan: Plan, tcp: Matrix, pose: Matrix, bound_m: float, time_s: float, measured: bool
    ) -> Evidence:
        value = offset_m(tcp, pose @ plan.task.asset(self.object).points[self.point].object_from_tcp)
        about: About = {"measured": measured, "object": self.object, "aspect": self.point}
        return self.found(value <= bound_m, Finding.BESIDE_POINT, value, bound_m, time_s, **about)

    def _nearest_m(self, plan: Plan) -> float:
        """How near the TCP comes to the point where it is now."""
        tcp = plan.planning_scene.arms[self.agent - 1].tcp(plan.trajectory(self.agent).path())  # (P, 4, 4)
        point = (
            plan.scene.poses[self.object] @ plan.task.asset(self.object).points[self.point].object_from_tcp
        )
        return float(np.linalg.norm(tcp[:, :3, 3] - point[:3, 3], axis=1).min())

    def stl(self, task: Task) -> Specification:
        about, who = (self.agent, self.object, self.point), agent_name(self.agent)
        how = f"from the measured gripper of {who} to point {self.point} of {self.object}"
        when = f"{who} has made contact with {self.object} in this control step"
        meets = named("meets", *about), when
        return bounded(self, (named("offset", *about), how), "<=", POSITION_MEASURED_M, meets)


@dataclass(frozen=True)
class PlaceAtCheck(OneAgentCheck):
    """What the agent carries is let go at the annotated point of a target, on the level. In metres.

    Judged before anything moves, by where the plan lets go.
    """

    states, name, unit = PlaceAt, CheckName.INTERACTION, "m"

    agent: int
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
        trajectory, arm = plan.trajectory(self.agent), plan.planning_scene.arms[self.agent - 1]
        worst = self.idle(plan, bound_m)
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            if segment.subgoal.target == self.target and segment.primitive == "lower":
                assert segment.tcp_from_object is not None  # PlanningScene.along has refused it otherwise
                placed = arm.tcp(segment.qpos[-1]) @ segment.tcp_from_object
                goal = plan.scene.poses[self.target] @ point.object_from_tcp
                value, time_s = (
                    float(np.linalg.norm(placed[:2, 3] - goal[:2, 3])),
                    plan.time_s(self.agent, end),
                )
                about: About = {"object": segment.attached, "aspect": f"{self.point} point of {self.target}"}
                ok = value <= bound_m
                worst = self.found(ok, Finding.PUT_BESIDE_POINT, value, bound_m, time_s, **about)
        return worst

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
        return of_schedule((always([f"{offset.name} <= {bound_m!r}"], "m", puts),), offset, puts)
