"""Interaction position (paper, section 3.2): where an object is met, and where it is put.

The tool centre point (TCP) at contact is compared with the annotated interaction points of the asset.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rf_exp.constraints.checks.contact import last_contact, no_contact, offset_m, settles_now
from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Plan
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_DT_S, Kind, Scene

PLACES = ("place", "drop")  # kinds of interaction points at which something is let go
POSITION_M = 0.01  # of the TCP from the interaction point, planned
POSITION_MEASURED_M = 0.03  # fingers shift what they close on


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
        contact = last_contact(plan, self.agent, self.object)
        if contact is None:
            missed = Finding.NO_CONTACT, self.point, self._nearest_m(plan), POSITION_M
            return no_contact(plan, self.agent, self.object, *missed)
        time_s = plan.time_s(self.agent, contact.end)
        pose = contact.object_pose(plan, self.object)
        return self._evidence(plan, contact.tcp(plan), pose, POSITION_M, time_s, False)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if plan.task.asset(self.object).points[self.point].kind in PLACES:
            return None
        contact = last_contact(plan, self.agent, self.object)
        if contact is None or not settles_now(plan, self.agent, scene, contact.settled):
            return None
        tcp = plan.planning_scene.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        time_s = scene.step * CONTROL_DT_S
        return self._evidence(plan, tcp, scene.poses[self.object], POSITION_MEASURED_M, time_s, True)

    def _evidence(
        self, plan: Plan, tcp: Matrix, pose: Matrix, bound_m: float, time_s: float, measured: bool
    ) -> Evidence:
        point = plan.task.asset(self.object).points[self.point]
        value = offset_m(tcp, pose @ point.object_from_tcp)
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
        tcp = plan.planning_scene.arms[self.agent - 1].tcp(plan.trajectory(self.agent).path())  # (P, 4, 4)
        point = (
            plan.scene.poses[self.object] @ plan.task.asset(self.object).points[self.point].object_from_tcp
        )
        return float(np.linalg.norm(tcp[:, :3, 3] - point[:3, 3], axis=1).min())

    def _placed(self, plan: Plan) -> Evidence:
        """A place point: where what the agent carries is let go. Counted on the level."""
        point = plan.task.asset(self.object).points[self.point]
        bound_m = point.slack_m + POSITION_M
        trajectory, arm = plan.trajectory(self.agent), plan.planning_scene.arms[self.agent - 1]
        worst = idle(plan, self.agents, bound=bound_m)
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            if segment.subgoal.target == self.object and segment.primitive == "lower":
                assert segment.tcp_from_object is not None  # PlanningScene.along has refused it otherwise
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
                    object=segment.attached,
                    aspect=f"{self.point} point of {self.object}",
                )
        return worst
