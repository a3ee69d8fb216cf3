"""Spatial constraints: who may not be where (paper: Spatial Occupancy Validation).

Every question is looked at twice. The first look is cheap and misses nothing: spheres round the
pieces, which are as safe as voxels filled from volume (`occupancy`, what people look at) and
cheaper. What it flags is measured exactly (coal), so a false alarm stops nobody.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from rf_exp.constraints.checks.touching import measured_arms, touching
from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Plan
from rf_exp.findings import CheckName, Finding, names
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M, Swept, lowest_m, nearest
from rf_exp.tasks import Task
from rf_exp.timeline import doing
from rf_exp.types import CONTROL_DT_S, Kind, Scene

TRAILS_STEPS = 10  # control steps that a measured joint may trail its command


@dataclass(frozen=True)
class AvoidAgents:
    """One agent keeps clear of all others, or several of one another. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)})"

    def pairs(self, task: Task) -> tuple[tuple[int, int], ...]:
        """The pairs (i, j), i < j, that this is about."""
        every = combinations(task.agents, 2)
        if len(self.agents) == 1:
            return tuple(pair for pair in every if self.agents[0] in pair)
        return tuple(pair for pair in every if set(pair) <= set(self.agents))

    def planned(self, plan: Plan) -> Evidence:
        least = idle(plan, self.agents, AGENT_MARGIN_M, np.inf)
        for i, j in self.pairs(plan.task):
            at = np.stack([plan.positions(i), plan.positions(j)], axis=1)
            hits = np.flatnonzero(plan.paths.diagrams[i, j][at[:, 0], at[:, 1]])
            cells = at[hits[:1]] if len(hits) else at
            gap = nearest(plan.paths.swept[i - 1], plan.paths.swept[j - 1], cells)
            assert gap is not None  # links must always keep apart
            if len(hits):
                row, column = (int(position) for position in cells[0])
                return Evidence(
                    ok=False,
                    finding=Finding.CLOSE,
                    value=gap.distance_m,
                    bound=AGENT_MARGIN_M,
                    time_s=plan.begins_s + float(hits[0]) * CONTROL_DT_S,
                    agents=(i, j),
                    doing=(doing(plan.segment_at(i, row)), doing(plan.segment_at(j, column))),
                    parts=(gap.a, gap.b),
                )
            if gap.distance_m < least.value:
                when = int(np.flatnonzero((at == gap.at).all(axis=1))[0])
                least = Evidence(
                    ok=True,
                    finding=Finding.CLEAR,
                    value=gap.distance_m,
                    bound=AGENT_MARGIN_M,
                    time_s=plan.begins_s + when * CONTROL_DT_S,
                    agents=(i, j),
                )
        return least

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        may_touch = {agent: may_touch_now(plan, agent, scene) for agent in plan.task.agents}
        return touching(plan.task, scene, self.pairs(plan.task), may_touch)


def apart_m(plan: Plan, scene: Scene, pair: tuple[int, int]) -> float:
    """How far two measured arms are from what `AvoidAgents` stops them for; negative: penetration depth."""
    (bodies,) = measured_arms(
        plan.task, scene, (pair,), {agent: may_touch_now(plan, agent, scene) for agent in pair}
    )
    gap = nearest(*bodies)
    assert gap is not None  # links must always keep apart
    return gap.distance_m


def may_touch_now(plan: Plan, agent: int, scene: Scene) -> frozenset[str]:
    """What an agent may touch by its plan, now or just before: a measured arm trails its commands."""
    recent = plan.recent(agent, scene, TRAILS_STEPS)
    body = plan.paths.swept[agent - 1]
    allowed = [*body.touches.items(), *body.rests.items()]
    return frozenset(name for name, mask in allowed if mask[recent].any())


@dataclass(frozen=True)
class AvoidObjects:
    """Agents touch nothing but what their segments are about, nor the table. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)}, objects)"

    def planned(self, plan: Plan) -> Evidence:
        least = idle(plan, self.agents, OBJECT_MARGIN_M, np.inf)
        for agent in self.agents:
            body, still = plan.paths.swept[agent - 1], plan.paths.still[agent - 1]
            positions = np.unique(plan.positions(agent))
            hits = positions[plan.paths.blocked[agent - 1][positions]]
            if len(hits):
                return self._hit(plan, agent, int(hits[0]), body, still)
            gap = nearest(body, still, np.stack([positions, 0 * positions], axis=1))
            if gap is not None and gap.distance_m < least.value:
                least = Evidence(
                    ok=True,
                    finding=Finding.CLEAR_OF_THING,
                    value=gap.distance_m,
                    bound=OBJECT_MARGIN_M,
                    time_s=plan.time_s(agent, gap.at[0]),
                    agents=(agent,),
                    obstacles=(gap.b,),
                )
        return least

    def _hit(self, plan: Plan, agent: int, position: int, body: Swept, still: Swept) -> Evidence:
        finer = plan.paths.finer(agent)
        rows = np.arange(len(finer))[plan.paths.around(position)]
        gap = nearest(finer, still, np.stack([rows, 0 * rows], axis=1))
        low_m = float(lowest_m(body)[position])
        part, thing, value = ("arm", "the table", low_m)
        if gap is not None and (low_m >= 0 or gap.distance_m < low_m):
            part, thing, value = gap.a, gap.b, gap.distance_m
        return Evidence(
            ok=False,
            finding=Finding.CLOSE_TO_THING,
            value=value,
            bound=OBJECT_MARGIN_M,
            time_s=plan.time_s(agent, position),
            agents=(agent,),
            obstacles=(thing,),
            doing=(doing(plan.segment_at(agent, position)),),
            parts=(part,),
        )

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        return None  # contacts with objects are wanted and unwanted ones alike; see the monitor's tracking
