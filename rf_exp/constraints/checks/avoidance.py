"""Spatial constraints: clearance between agents and from objects (paper: Spatial Occupancy Validation).

Every query has two phases. The broad phase is cheap and conservative: bounding spheres of the pieces, which
are as safe as voxels filled from volume (`occupancy`, for display) and cheaper. What it flags is measured
exactly (coal), so a false alarm has no effect.
"""

from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import Check, Evidence
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import VOID, Execution, Signal, Specification, always, named
from rf_exp.findings import About, CheckName, Finding, agent_name, names
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    TABLE_MARGIN_M,
    PlanningScene,
    Separation,
    Swept,
    Touches,
    lowest_m,
    measured_pair,
    nearest,
)
from rf_exp.statements import AvoidAgents, AvoidObjects
from rf_exp.tasks import Task
from rf_exp.types import Scene

TRAILS_STEPS = 10  # control steps that a measured joint may trail its command
CONTACT_N = 1.0  # force between two arms that counts as contact
STOP_N = 20.0  # protective stop of both, as of Pandas with the thresholds of libfranka's examples
Pair = tuple[int, int]  # of agents


@dataclass(frozen=True)
class AvoidAgentsCheck(Check):
    """One agent keeps clear of all others, or several of one another. Value and bound in metres."""

    states, name, unit = AvoidAgents, CheckName.OCCUPANCY, "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)})"

    def pairs(self, task: Task) -> tuple[Pair, ...]:
        """The pairs (i, j), i < j, that are checked."""
        own = set(self.agents)
        return tuple(pair for pair in combinations(task.agents, 2) if own <= {*pair} or own >= {*pair})

    def planned(self, plan: Plan) -> Evidence:
        least = self.idle(plan, AGENT_MARGIN_M, np.inf)
        for i, j in self.pairs(plan.task):
            at = np.stack([plan.positions(i), plan.positions(j)], axis=1)
            hits = np.flatnonzero(plan.paths.diagrams[i, j][at[:, 0], at[:, 1]])
            cells = at[hits[:1]] if len(hits) else at
            gap = nearest(plan.paths.swept[i - 1], plan.paths.swept[j - 1], cells)
            numbers = gap.distance_m, AGENT_MARGIN_M, plan.step_s(plan.first_step((i, j), gap.at))
            if len(hits):
                does, parts = plan.doing((i, j), gap.at), (gap.a, gap.b)
                return self.found(False, Finding.CLOSE, *numbers, agents=(i, j), doing=does, parts=parts)
            if gap.distance_m < least.value:
                least = self.found(True, Finding.CLEAR, *numbers, agents=(i, j))
        return least

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        may_touch = cache(partial(may_touch_now, plan, scene))
        return touching(plan.separation, scene, self.pairs(plan.task), may_touch)

    def stl(self, task: Task) -> Specification:
        pairs = self.pairs(task)
        if not pairs:
            return Specification(silent="there is no other agent to avoid")
        gaps, forces = [_gap(pair) for pair in pairs], [_force(pair) for pair in pairs]
        apart = always([f"{gap.name} > 0" for gap in gaps], "m", strict=True)
        gentle = always([f"{force.name} <= {CONTACT_N!r}" for force in forces], "N")
        return Specification((apart, gentle), (*gaps, *forces))


def may_touch_now(plan: Plan, scene: Scene, agent: int) -> frozenset[str]:
    """Objects that an agent may touch by its plan, now or just before: a measured arm trails its commands."""
    recent = plan.recent(agent, scene, TRAILS_STEPS)
    body = plan.paths.swept[agent - 1]
    allowed = [*body.touches.items(), *body.rests.items()]
    return frozenset(name for name, mask in allowed if mask[recent].any())


def _gap(pair: Pair) -> Signal:
    who = " and ".join(map(agent_name, pair))
    how = f"exact distance of the measured arms of {who} with what they hold; negative: penetration"

    def apart_m(execution: Execution) -> NDArray[np.float64]:
        plan, found = execution.plan, []
        for scene in execution.scenes:
            now, may_touch = PlanningScene(plan.task, scene), partial(may_touch_now, plan, scene)
            found.append(nearest(*measured_pair(now, pair, may_touch)).distance_m)
        return np.array(found)

    return Signal(named("distance", *pair), "m", how, apart_m)


def _force(pair: Pair) -> Signal:
    how = f"largest force between the arms of {' and '.join(map(agent_name, pair))}; 0 without contact"

    def largest_n(execution: Execution) -> NDArray[np.float64]:
        contacts = (scene.arm_contacts for scene in execution.scenes)
        forces_n = ([n for a, b, n in now if {a, b} == {*pair}] for now in contacts)
        return np.array([max(each, default=0.0) for each in forces_n])

    return Signal(named("force", *pair), "N", how, largest_n)


def touching(
    separation: Separation, scene: Scene, pairs: tuple[Pair, ...], may_touch: Touches
) -> Evidence | None:
    """The first pair of arms that touch: contact force from the simulator, or overlapping volume."""
    return pressing(scene, pairs) or overlapping(separation, scene, pairs, may_touch)


def pressing(scene: Scene, pairs: tuple[Pair, ...]) -> Evidence | None:
    """The first pair of arms whose contact force in the simulator exceeds CONTACT_N."""
    for a, b, force_n in scene.arm_contacts:
        if tuple(sorted((a, b))) in pairs and force_n > CONTACT_N:
            facts: About = {"measured": True, "agents": (a, b)}
            return Evidence(Finding.TOUCHING, force_n, CONTACT_N, "N", ok=False, time_s=scene.time_s, **facts)
    return None


def protective_stop(scene: Scene) -> bool:
    """Whether two arms press on one another so hard that both stop."""
    return any(force_n > STOP_N for *_, force_n in scene.arm_contacts)


def overlapping(
    separation: Separation, scene: Scene, pairs: tuple[Pair, ...], may_touch: Touches
) -> Evidence | None:
    """The first pair of arms whose exact volumes overlap, regardless of contacts in the simulator.

    An arm includes the object that it holds, at its measured pose. `may_touch` (of an agent) names what the
    agent's gripper, and the object in it, may touch in the gripper of another agent. `separation` is that of
    earlier scenes, or a new one.
    """
    for pair in pairs:
        gap = separation.overlap(scene, pair, may_touch)
        if gap is not None:
            facts: About = {"measured": True, "agents": pair, "parts": (gap.a, gap.b)}
            return Evidence(Finding.OVERLAPPING, gap.distance_m, ok=False, time_s=scene.time_s, **facts)
    return None


@dataclass(frozen=True)
class AvoidObjectsCheck(Check):
    """Agents touch neither the table nor objects that their segments do not involve. Value, bound in metres.

    Judged before execution: measured contacts with objects may be wanted or not, and the monitor finds an
    agent that strays from its path.
    """

    states, name, unit = AvoidObjects, CheckName.OCCUPANCY, "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)}, objects)"

    def planned(self, plan: Plan) -> Evidence:
        least = self.idle(plan, OBJECT_MARGIN_M, np.inf)
        for agent in self.agents:
            body, still = plan.paths.swept[agent - 1], plan.paths.still[agent - 1]
            positions = np.unique(plan.positions(agent))
            hits = positions[plan.paths.blocked[agent - 1][positions]]
            if len(hits):
                return self._hit(plan, agent, int(hits[0]), body, still)
            gap = nearest(body, still, np.stack([positions, 0 * positions], axis=1))
            if gap.distance_m < least.value:
                about: About = {"agents": (agent,), "obstacles": (gap.b,)}
                numbers = gap.distance_m, OBJECT_MARGIN_M, plan.time_s(agent, gap.at[0])
                least = self.found(True, Finding.CLEAR_OF_THING, *numbers, **about)
        return least

    def _hit(self, plan: Plan, agent: int, position: int, body: Swept, still: Swept) -> Evidence:
        finer = plan.paths.finer(agent)
        rows = np.arange(len(finer))[plan.paths.around(position)]
        gap = nearest(finer, still, np.stack([rows, 0 * rows], axis=1))
        low_m = float(lowest_m(body)[position])
        part, thing, value = "arm", "the table", low_m
        if gap.a and (low_m >= 0 or gap.distance_m < low_m):
            part, thing, value = gap.a, gap.b, gap.distance_m
        numbers = value, OBJECT_MARGIN_M, plan.time_s(agent, position)
        does = plan.doing((agent,), (position,))
        about: About = {"agents": (agent,), "obstacles": (thing,), "parts": (part,), "doing": does}
        return self.found(False, Finding.CLOSE_TO_THING, *numbers, **about)

    def stl(self, task: Task) -> Specification:
        clear = [_clearance(agent) for agent in self.agents]
        low = [_lowest(agent) for agent in self.agents]
        things = always([f"{each.name} >= {OBJECT_MARGIN_M!r}" for each in clear], "m")
        # A formula of its own: grippers are nearer to the table than to objects, whose margins it would hide.
        table = always([f"{each.name} >= {TABLE_MARGIN_M!r}" for each in low], "m")
        return Specification((things, table), (*clear, *low), measured=False)


def _clearance(agent: int) -> Signal:
    def clearance_m(execution: Execution) -> NDArray[np.float64]:
        paths, at = execution.plan.paths, execution.positions(agent)
        body, still = paths.swept[agent - 1], paths.still[agent - 1]
        low_m, found = lowest_m(body), {}
        for position in np.unique(at).tolist():
            gap_m = nearest(body, still, np.array([[position, 0]])).distance_m
            found[position] = min(gap_m, 2 * VOID)  # still VOID less the margin
            if paths.blocked[agent - 1][position] and low_m[position] >= TABLE_MARGIN_M:  # flagged: too close
                found[position] = min(found[position], np.nextafter(OBJECT_MARGIN_M, 0.0))
        return np.array([found[position] for position in at.tolist()])

    how = (
        f"from {agent_name(agent)} where it is commanded to what nobody moves and it may not touch; "
        "less than the margin where the motion to the next step may be"
    )
    return Signal(named("clearance", agent), "m", how, clearance_m)


def _lowest(agent: int) -> Signal:
    def lowest(execution: Execution) -> NDArray[np.float64]:
        return lowest_m(execution.plan.paths.swept[agent - 1])[execution.positions(agent)]

    how = f"lowest point of {agent_name(agent)} where it is commanded, with what it carries, over the table"
    return Signal(named("lowest", agent), "m", how, lowest)
