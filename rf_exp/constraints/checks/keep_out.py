from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck, Plans
from rf_exp.constraints.phases import span, step_parts
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import Specification, named
from rf_exp.coordination import Closing
from rf_exp.findings import About, CheckName, Doing, Finding, agent_name
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

    states, name, unit = KeepOut, CheckName.OCCUPANCY, "m"
    finding, comparison, bounds = Finding.IN_ZONE, ">", (0.0, 0.0)

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    text: str = ""
    occupied_by: int | str | None = None
    until: Step | None = None

    @classmethod
    def compiled(cls, stated: KeepOut, plans: Plans) -> "KeepOutCheck":
        check = super().compiled(stated, plans)
        if check.until is not None and check.until.agent == check.agent:
            raise plans.refused(f"waits for {agent_name(check.agent)} itself")
        return check

    def __repr__(self) -> str:
        inside = self.occupied_by
        when = f", while {agent_name(inside) if isinstance(inside, int) else inside}" if inside else ""
        when += f", until {self.until.text}" if self.until else ""
        return f"VSO({agent_name(self.agent)}, zone {self.low_m} to {self.high_m}{when})"

    def _zone(self) -> Swept:
        return _box(self.low_m, self.high_m)

    def _inside(self, paths: Paths, agent: int) -> Mask:
        """(P,) the path positions at which an agent, with what it carries, is in the zone."""
        return closer_than(paths.swept[agent - 1], self._zone(), 0.0)[:, 0]

    def _closed(self, paths: Paths) -> tuple[int, Mask]:
        """The agent whose path closes the zone, and at which of its positions (P,) it is closed."""
        if self.until is not None:
            other = self.until.agent
            part = span(self.until, paths.trajectory(other))
            ends = 0 if part is None else part[1]
            return other, np.arange(len(paths.trajectory(other)) + 1) < ends
        if isinstance(self.occupied_by, int):
            return self.occupied_by, self._inside(paths, self.occupied_by)
        closed, name = True, self.occupied_by
        if name is not None:  # closed by the agent that moves the object, if any
            for agent, body in zip(paths.task.agents, paths.swept, strict=True):
                if name in body.objects:
                    return agent, closer_than(body.only(name), self._zone(), 0.0)[:, 0]
            closed = bool(overlap(paths.planning_scene.standing([name]), self._zone()))
        return self.agent, np.full(len(paths.trajectory(self.agent)) + 1, closed)

    def rule(self, paths: Paths) -> Closing | None:
        other, closed = self._closed(paths)
        if other == self.agent:
            return None
        mask = self._inside(paths, self.agent)[:, None] & closed[None, :]
        return Closing((self.agent, other), mask)

    def planned(self, plan: Plan) -> Evidence:
        body, own = plan.paths.swept[self.agent - 1], plan.positions(self.agent)
        other, closed = self._closed(plan.paths)
        steps = np.flatnonzero(closed[plan.positions(other)])  # at which the zone is closed
        if not len(steps):
            return self.idle(plan, 0.0, np.inf)
        hits = steps[self._inside(plan.paths, self.agent)[own[steps]]]
        at = np.unique(own[hits[:1]] if len(hits) else own[steps])
        gap = nearest(body, self._zone(), np.stack([at, 0 * at], axis=1))
        time_s = plan.step_s(int(steps[own[steps] == gap.at[0]][0]))
        return self._beside(gap, not len(hits), time_s, plan.doing(self.agents, gap.at[:1]))

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if not self._closed_now(scene, plan):
            return None
        gap = self._gap(scene, plan, self.agent)
        return self._beside(gap, gap.distance_m > 0, scene.time_s)

    def _closed_now(self, scene: Scene, plan: Plan) -> bool:
        if self.until is not None:
            other, closed = self._closed(plan.paths)
            return bool(closed[plan.position_now(other, scene)])
        if isinstance(self.occupied_by, int):
            return self._gap(scene, plan, self.occupied_by).distance_m <= 0
        if self.occupied_by is not None:
            thing = PlanningScene(plan.task, scene).standing([self.occupied_by])
            return overlap(thing, self._zone()) is not None
        return True

    def _gap(self, scene: Scene, plan: Plan, agent: int) -> Nearest:
        """Distance from a measured arm, with what it holds, to the zone."""
        arm = PlanningScene(plan.task, scene).measured(agent, attached=scene.held[agent - 1], touches=())
        return nearest(arm, self._zone())

    def _beside(self, gap: Nearest, ok: bool, time_s: float, does: tuple[Doing | None, ...] = ()) -> Evidence:
        """`does`: activity of the agent in the plan; empty for a measured distance."""
        finding, zone = Finding.OUT_OF_ZONE if ok else self.finding, f"zone {self.low_m} to {self.high_m}"
        about: About = {"measured": not does, "obstacles": (zone,), "doing": does, "parts": (gap.a,)}
        return self.found(ok, finding, gap.distance_m, 0.0, time_s, **about)

    def stl(self, task: Task) -> Specification:
        zone = named(self.agent, *map(float, (*self.low_m, *self.high_m)))
        if self.occupied_by is not None:
            zone = named(zone, "while", self.occupied_by)
        elif self.until is not None:
            zone = named(zone, "until", *step_parts(self.until))
        how = f"from {agent_name(self.agent)}, measured, with what it holds, to the zone; negative: inside"
        return self.formula(f"outside_{zone}", how, (f"closed_{zone}", "the zone is closed"))


@lru_cache(maxsize=64)  # called at every control step
def _box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> Swept:
    """A zone between two corners, as a static body (P = 1)."""
    low, high = np.array(low_m), np.array(high_m)
    box = trimesh.creation.box(high - low, transform((low + high) / 2))
    return Swept((Piece.of(box),), ("zone",), np.eye(4).reshape(1, 1, 4, 4))
