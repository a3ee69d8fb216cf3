"""Spatial constraints: who may not be where (paper: Spatial Occupancy Validation).

Every question is looked at twice. The first look is cheap and misses nothing: spheres round the
pieces, which are as safe as voxels filled from volume (`occupancy`, what people look at) and
cheaper. What it flags is measured exactly (coal), so a false alarm stops nobody.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import combinations
from typing import ClassVar

import numpy as np
import trimesh

from rf_exp.constraints.evidence import Evidence, idle, violation
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.temporal import span
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName, Doing, Finding, Violation, agent_name, names
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    Bodies,
    Mask,
    Nearest,
    Piece,
    Swept,
    closer_than,
    lowest_m,
    nearest,
    overlap,
)
from rf_exp.statements import Step
from rf_exp.tasks import Task
from rf_exp.timeline import doing
from rf_exp.transforms import inverse, transform
from rf_exp.types import CONTROL_DT_S, Kind, Scene

CONTACT_N = 1.0  # force between two arms that counts as contact
TRAILS_STEPS = 10  # control steps that a measured joint may trail its command


def touching(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]] | None = None,
) -> Evidence | None:
    """The first pair of arms that touch: contact force from the simulator, or overlapping volume."""
    return pressing(scene, pairs) or overlapping(task, scene, pairs, may_touch)


def pressing(scene: Scene, pairs: tuple[tuple[int, int], ...]) -> Evidence | None:
    """The first pair of arms that the simulator sees press on one another."""
    for a, b, force_n in scene.arm_contacts:
        if tuple(sorted((a, b))) in pairs and force_n > CONTACT_N:
            return Evidence(
                ok=False,
                finding=Finding.TOUCHING,
                value=force_n,
                bound=CONTACT_N,
                unit="N",
                time_s=scene.step * CONTROL_DT_S,
                agents=(a, b),
                measured=True,
            )
    return None


def overlapping(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]] | None = None,
) -> Evidence | None:
    """The first pair of arms whose exact volumes overlap, whatever the simulator says.

    What an arm holds is part of it, where it was measured. `may_touch` (agent -> objects) names what the
    gripper of an agent, and what it holds, may touch in the hands of another one.
    """
    for (a, b), bodies in zip(pairs, _bodies(task, scene, pairs, may_touch or {}), strict=True):
        gap = overlap(*bodies)
        if gap is not None:
            return Evidence(
                ok=False,
                finding=Finding.OVERLAPPING,
                value=gap.distance_m,
                time_s=scene.step * CONTROL_DT_S,
                agents=(a, b),
                measured=True,
                parts=(gap.a, gap.b),
            )
    return None


def apart_m(plan: Plan, scene: Scene, pair: tuple[int, int]) -> float:
    """How far two measured arms are from what `AvoidAgents` stops them for; negative: penetration depth."""
    (bodies,) = _bodies(plan.task, scene, (pair,), {agent: _about(plan, agent, scene) for agent in pair})
    gap = nearest(*bodies)
    assert gap is not None  # links must always keep apart
    return gap.distance_m


def _bodies(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]],
) -> Iterator[tuple[Swept, Swept]]:
    """Pairs of measured arms, each with what it holds."""
    bodies = Bodies(task, scene)

    @cache
    def body(agent: int, load: str | None) -> Swept:
        return _with_load(bodies, agent, load, may_touch.get(agent, frozenset()))

    for a, b in pairs:
        loads = scene.held[a - 1], scene.held[b - 1]
        if loads[0] == loads[1]:  # what two hold together is no obstacle between them
            loads = None, None
        yield body(a, loads[0]), body(b, loads[1])


def _with_load(bodies: Bodies, agent: int, load: str | None, may_touch: frozenset[str]) -> Swept:
    """A measured arm with something where it was measured."""
    scene, arm = bodies.scene, bodies.arms[agent - 1]
    qpos = scene.qpos[agent - 1]
    grip = None if load is None else inverse(arm.tcp(qpos)) @ scene.poses[load]
    return bodies.arm(agent, qpos, carries=load, tcp_from_object=grip, touches=may_touch)


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
        may_touch = {agent: _about(plan, agent, scene) for agent in plan.task.agents}
        return touching(plan.task, scene, self.pairs(plan.task), may_touch)


def _about(plan: Plan, agent: int, scene: Scene) -> frozenset[str]:
    """What an agent may touch by its plan, now or just before: a measured arm trails its commands."""
    positions, now = plan.positions(agent), scene.step - plan.scene.step
    recent = np.unique(positions[np.clip(np.arange(now - TRAILS_STEPS, now + 1), 0, len(positions) - 1)])
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


@dataclass(frozen=True)
class StayOut:
    """An agent, with what it carries, stays out of a box. Value and bound in metres.

    Where it is closed only while an agent or an object is in it, or until a part of a plan is over, timing
    can keep the agent out (`closing`).
    """

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[CheckName] = CheckName.OCCUPANCY
    unit: ClassVar[str] = "m"

    agent: int
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    text: str = ""
    occupied_by: int | str | None = None
    until: Step | None = None

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def __repr__(self) -> str:
        when = "" if self.occupied_by is None else f", while {self._occupant}"
        when += f", until {self.until.text}" if self.until else ""
        return f"VSO({agent_name(self.agent)}, zone {self.low_m} to {self.high_m}{when})"

    @property
    def _occupant(self) -> str:
        return agent_name(self.occupied_by) if isinstance(self.occupied_by, int) else str(self.occupied_by)

    def _zone(self) -> Swept:
        return _box(self.low_m, self.high_m)

    def _inside(self, paths: Paths, agent: int) -> Mask:
        """(P,) the path positions at which an agent, with what it carries, is in the zone."""
        return closer_than(paths.swept[agent - 1], self._zone(), 0.0)[:, 0]

    def _closed(self, paths: Paths) -> tuple[int, Mask]:
        """Whose path decides when the zone is closed, and at which of its positions (P,)."""
        if self.until is not None:
            other = self.until.agent
            part = span(self.until, paths.trajectory(other))
            ends = 0 if part is None else part[1]
            return other, np.arange(len(paths.trajectory(other)) + 1) < ends
        if isinstance(self.occupied_by, int):
            return self.occupied_by, self._inside(paths, self.occupied_by)
        if self.occupied_by is not None:
            return self._with_thing(paths, self.occupied_by)
        return self.agent, np.ones(len(paths.trajectory(self.agent)) + 1, dtype=bool)

    def _with_thing(self, paths: Paths, name: str) -> tuple[int, Mask]:
        """As `_closed`, by an object: who moves it decides, or nobody."""
        for agent, body in zip(paths.task.agents, paths.swept, strict=True):
            if name in body.objects:
                columns = [column for column, label in enumerate(body.labels) if label == name]
                thing = Swept(
                    tuple(body.pieces[column] for column in columns), (name,) * len(columns),
                    body.poses[:, columns],
                )  # fmt: skip
                return agent, closer_than(thing, self._zone(), 0.0)[:, 0]
        standing = bool(overlap(paths.bodies.standing([name]), self._zone()))
        return self.agent, np.full(len(paths.trajectory(self.agent)) + 1, standing)

    def closing(self, paths: Paths) -> "Closing | None":
        """What timing has to do about it; None where it can do nothing."""
        other, closed = self._closed(paths)
        if other == self.agent:
            return None
        mask = self._inside(paths, self.agent)[:, None] & closed[None, :]
        i, j = sorted((self.agent, other))
        return Closing((i, j), mask if i == self.agent else mask.T)

    def planned(self, plan: Plan) -> Evidence:
        body, other = plan.paths.swept[self.agent - 1], self._closed(plan.paths)
        own = plan.positions(self.agent)
        steps = np.flatnonzero(other[1][plan.positions(other[0])])  # at which the zone is closed
        if not len(steps):
            return idle(plan, self.agents, 0.0, np.inf)
        hits = steps[self._inside(plan.paths, self.agent)[own[steps]]]
        at = np.unique(own[hits[:1]] if len(hits) else own[steps])
        gap = nearest(body, self._zone(), np.stack([at, 0 * at], axis=1))
        assert gap is not None  # a zone must always be kept out of
        step = hits[0] if len(hits) else steps[own[steps] == gap.at[0]][0]
        time_s = plan.begins_s + float(step) * CONTROL_DT_S
        does = doing(plan.segment_at(self.agent, gap.at[0]))
        return self._evidence(gap, not len(hits), time_s, False, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        if not self._closed_now(scene, plan):
            return None
        gap = self._gap(scene, plan, self.agent)
        return self._evidence(gap, gap.distance_m > 0, scene.step * CONTROL_DT_S, True)

    def _closed_now(self, scene: Scene, plan: Plan) -> bool:
        if self.until is not None:
            other, closed = self._closed(plan.paths)
            return bool(closed[plan.position_now(other, scene)])
        if isinstance(self.occupied_by, int):
            return self._gap(scene, plan, self.occupied_by).distance_m <= 0
        if self.occupied_by is not None:
            return overlap(Bodies(plan.task, scene).standing([self.occupied_by]), self._zone()) is not None
        return True

    def _gap(self, scene: Scene, plan: Plan, agent: int) -> Nearest:
        """From a measured arm, with what it holds, to the zone."""
        held = scene.held[agent - 1]
        gap = nearest(_with_load(Bodies(plan.task, scene), agent, held, frozenset()), self._zone())
        assert gap is not None
        return gap

    def _evidence(
        self, gap: Nearest, ok: bool, time_s: float, measured: bool, does: Doing | None = None
    ) -> Evidence:
        return Evidence(
            ok=ok,
            finding=Finding.OUT_OF_ZONE if ok else Finding.IN_ZONE,
            value=gap.distance_m,
            time_s=time_s,
            agents=self.agents,
            measured=measured,
            obstacles=(f"zone {self.low_m} to {self.high_m}",),
            doing=() if measured else (does,),
            parts=(gap.a,),
        )


@lru_cache(maxsize=64)  # asked for at every control step
def _box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> Swept:
    """A zone between two corners, as a body that stands (P = 1)."""
    low, high = np.array(low_m), np.array(high_m)
    box = trimesh.creation.box(high - low, transform((low + high) / 2))
    return Swept((Piece.of(box),), ("zone",), np.eye(4).reshape(1, 1, 4, 4))


@dataclass(frozen=True)
class Closing:
    """A rule of a schedule: an agent stays out of a zone while another one, or its progress, closes it."""

    pair: tuple[int, int]  # (i, j), i < j
    cells: Mask  # (P_i, P_j) path positions that may not be at the same time

    def demand(self, demands: Demands) -> None:
        demands.apart(*self.pair, self.cells)


class PolicyMonitor:
    """Watches a policy act: arms that touch or overlap, nothing else. For counting, not for stopping.

    What a policy is about is unknown, so a gripper, or what it holds, may meet what another one holds.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs = tuple(combinations(task.agents, 2))
        self._may_touch = dict.fromkeys(task.agents, frozenset(task.objects))

    def __call__(self, scene: Scene) -> Violation | None:
        found = touching(self._task, scene, self._pairs, self._may_touch)
        if found is None:
            return None
        return violation(AvoidAgents(found.agents), found)
