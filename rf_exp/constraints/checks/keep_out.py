from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck, PlanContext
from rf_exp.constraints.phases import span, step_name_parts
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.coordination import ForbiddenPairs
from rf_exp.findings import CheckName, Doing, FactArguments, Finding, agent_name
from rf_exp.geometry import Mask, Nearest, Piece, PlanningScene, Swept, closer_than, nearest, overlap
from rf_exp.statements import KeepOut, Step
from rf_exp.tasks import Task
from rf_exp.transforms import transform
from rf_exp.types import Scene


@dataclass(frozen=True)
class KeepOutCheck(OneAgentCheck, BoundedCheck):
    """An agent, with what it carries, stays out of a zone (a box). Value and bound in metres.

    Where the zone is closed only while an agent or an object is in it, or until a part of a plan is over,
    timing can keep the agent out (`rule`).
    """

    statement_type, name, unit = KeepOut, CheckName.OCCUPANCY, "m"
    finding, comparison, bounds = Finding.IN_ZONE, ">", (0.0, 0.0)

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    text: str = ""
    occupied_by: int | str | None = None
    until: Step | None = None

    @classmethod
    def from_statement(cls, statement: KeepOut, context: PlanContext) -> "KeepOutCheck":
        check = super().from_statement(statement, context)
        if check.until is not None and check.until.agent == check.agent:
            raise context.error(f"waits for {agent_name(check.agent)} itself")
        return check

    def __repr__(self) -> str:
        occupant = self.occupied_by
        when = (
            f", while {agent_name(occupant) if isinstance(occupant, int) else occupant}" if occupant else ""
        )
        when += f", until {self.until.text}" if self.until else ""
        return f"VSO({agent_name(self.agent)}, zone {self.low_m} to {self.high_m}{when})"

    def _zone(self) -> Swept:
        return _zone_body(self.low_m, self.high_m)

    def _is_inside(self, paths: Paths, agent: int) -> Mask:
        """(P,) the path positions at which an agent, with what it carries, is in the zone."""
        return closer_than(paths.swept[agent - 1], self._zone(), 0.0)[:, 0]

    def _closing_agent(self, paths: Paths) -> tuple[int, Mask]:
        """The agent whose path closes the zone, and at which of its positions (P,) it is closed."""
        if self.until is not None:
            other = self.until.agent
            part = span(self.until, paths.trajectory(other))
            end = 0 if part is None else part[1]
            return other, np.arange(len(paths.trajectory(other)) + 1) < end
        if isinstance(self.occupied_by, int):
            return self.occupied_by, self._is_inside(paths, self.occupied_by)
        closed, name = True, self.occupied_by
        if name is not None:  # closed by the agent that moves the object, if any
            for agent, body in zip(paths.task.agents, paths.swept, strict=True):
                if name in body.objects:
                    return agent, closer_than(body.only(name), self._zone(), 0.0)[:, 0]
            closed = bool(overlap(paths.planning_scene.static_objects([name]), self._zone()))
        return self.agent, np.full(len(paths.trajectory(self.agent)) + 1, closed)

    def rule(self, paths: Paths) -> ForbiddenPairs | None:
        other, closed = self._closing_agent(paths)
        if other == self.agent:
            return None
        mask = self._is_inside(paths, self.agent)[:, None] & closed[None, :]
        return ForbiddenPairs((self.agent, other), mask)

    def planned(self, plan: Plan) -> Evidence:
        body, own_positions = plan.paths.swept[self.agent - 1], plan.positions(self.agent)
        other, closed = self._closing_agent(plan.paths)
        steps = np.flatnonzero(closed[plan.positions(other)])  # at which the zone is closed
        if not len(steps):
            return self.not_applicable(plan, 0.0, np.inf)
        hits = steps[self._is_inside(plan.paths, self.agent)[own_positions[steps]]]
        positions = np.unique(own_positions[hits[:1]] if len(hits) else own_positions[steps])
        gap = nearest(body, self._zone(), np.stack([positions, 0 * positions], axis=1))
        time_s = plan.step_end_s(int(steps[own_positions[steps] == gap.at[0]][0]))
        return self._zone_evidence(gap, not len(hits), time_s, plan.doing(self.agents, gap.at[:1]))

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if not self._is_closed(scene, plan):
            return None
        gap = self._gap(scene, plan, self.agent)
        return self._zone_evidence(gap, gap.distance_m > 0, scene.time_s)

    def _is_closed(self, scene: Scene, plan: Plan) -> bool:
        if self.until is not None:
            other, closed = self._closing_agent(plan.paths)
            return bool(closed[plan.position_now(other, scene)])
        if isinstance(self.occupied_by, int):
            return self._gap(scene, plan, self.occupied_by).distance_m <= 0
        if self.occupied_by is not None:
            occupant = PlanningScene(plan.task, scene).static_objects([self.occupied_by])
            return overlap(occupant, self._zone()) is not None
        return True

    def _gap(self, scene: Scene, plan: Plan, agent: int) -> Nearest:
        """Distance from a measured arm, with what it holds, to the zone."""
        arm = PlanningScene(plan.task, scene).measured(agent, attached=scene.held[agent - 1], touches=())
        return nearest(arm, self._zone())

    def _zone_evidence(
        self, gap: Nearest, ok: bool, time_s: float, activities: tuple[Doing | None, ...] = ()
    ) -> Evidence:
        """`activities`: activity of the agent in the plan; empty for a measured distance."""
        finding, zone = Finding.OUT_OF_ZONE if ok else self.finding, f"zone {self.low_m} to {self.high_m}"
        facts: FactArguments = {
            "measured": not activities,
            "obstacles": (zone,),
            "doing": activities,
            "parts": (gap.a,),
        }
        return self.make_evidence(ok, finding, gap.distance_m, 0.0, time_s, **facts)

    def stl(self, task: Task) -> Specification:
        zone = identifier(self.agent, *map(float, (*self.low_m, *self.high_m)))
        if self.occupied_by is not None:
            zone = identifier(zone, "while", self.occupied_by)
        elif self.until is not None:
            zone = identifier(zone, "until", *step_name_parts(self.until))
        description = (
            f"from {agent_name(self.agent)}, measured, with what it holds, to the zone; negative: inside"
        )
        return self.formula(f"outside_{zone}", description, (f"closed_{zone}", "the zone is closed"))


@lru_cache(maxsize=64)  # called at every control step
def _zone_body(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> Swept:
    """A zone between two corners, as a static body (P = 1)."""
    low, high = np.array(low_m), np.array(high_m)
    box = trimesh.creation.box(high - low, transform((low + high) / 2))
    return Swept((Piece.of(box),), ("zone",), np.eye(4).reshape(1, 1, 4, 4))
