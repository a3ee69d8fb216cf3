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
from rf_exp.constraints.stl import MAX_MARGIN, Execution, Signal, Specification, always, identifier
from rf_exp.findings import CheckName, FactArguments, Finding, agent_name, agent_names
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

TRACKING_LAG_STEPS = 10  # control steps that a measured joint may trail its command
CONTACT_N = 1.0  # force between two arms that counts as contact
STOP_N = 20.0  # protective stop of both, as of Pandas with the thresholds of libfranka's examples
Pair = tuple[int, int]  # of agents


@dataclass(frozen=True)
class AvoidAgentsCheck(Check):
    """One agent keeps clear of all others, or several of one another. Value and bound in metres."""

    statement_type, name, unit = AvoidAgents, CheckName.OCCUPANCY, "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({agent_names(self.agents)})"

    def pairs(self, task: Task) -> tuple[Pair, ...]:
        """The pairs (i, j), i < j, that are checked."""
        agents = set(self.agents)
        return tuple(pair for pair in combinations(task.agents, 2) if agents <= {*pair} or agents >= {*pair})

    def planned(self, plan: Plan) -> Evidence:
        closest = self.not_applicable(plan, AGENT_MARGIN_M, np.inf)
        for i, j in self.pairs(plan.task):
            positions = np.stack([plan.positions(i), plan.positions(j)], axis=1)
            hits = np.flatnonzero(plan.paths.diagrams[i, j][positions[:, 0], positions[:, 1]])
            cells = positions[hits[:1]] if len(hits) else positions
            gap = nearest(plan.paths.swept[i - 1], plan.paths.swept[j - 1], cells)
            numbers = gap.distance_m, AGENT_MARGIN_M, plan.step_end_s(plan.first_step((i, j), gap.at))
            if len(hits):
                activities, parts = plan.doing((i, j), gap.at), (gap.a, gap.b)
                return self.make_evidence(
                    False, Finding.CLOSE, *numbers, agents=(i, j), doing=activities, parts=parts
                )
            if gap.distance_m < closest.value:
                closest = self.make_evidence(True, Finding.CLEAR, *numbers, agents=(i, j))
        return closest

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        may_touch = cache(partial(permitted_contacts, plan, scene))
        return contact_evidence(plan.separation, scene, self.pairs(plan.task), may_touch)

    def stl(self, task: Task) -> Specification:
        pairs = self.pairs(task)
        if not pairs:
            return Specification(no_formulas_reason="there is no other agent to avoid")
        gaps, forces = [_distance_signal(pair) for pair in pairs], [_force_signal(pair) for pair in pairs]
        separated = always([f"{gap.name} > 0" for gap in gaps], "m", strict=True)
        low_force = always([f"{force.name} <= {CONTACT_N!r}" for force in forces], "N")
        return Specification((separated, low_force), (*gaps, *forces))


def permitted_contacts(plan: Plan, scene: Scene, agent: int) -> frozenset[str]:
    """Objects that an agent may touch by its plan, now or just before: a measured arm trails its commands."""
    recent = plan.recent_positions(agent, scene, TRACKING_LAG_STEPS)
    body = plan.paths.swept[agent - 1]
    allowed = [*body.touches.items(), *body.rests.items()]
    return frozenset(name for name, mask in allowed if mask[recent].any())


def _distance_signal(pair: Pair) -> Signal:
    names = " and ".join(map(agent_name, pair))
    description = f"exact distance of the measured arms of {names} with what they hold; negative: penetration"

    def distances_m(execution: Execution) -> NDArray[np.float64]:
        plan, distances = execution.plan, []
        for scene in execution.scenes:
            planning_scene, may_touch = (
                PlanningScene(plan.task, scene),
                partial(permitted_contacts, plan, scene),
            )
            distances.append(nearest(*measured_pair(planning_scene, pair, may_touch)).distance_m)
        return np.array(distances)

    return Signal(identifier("distance", *pair), "m", description, distances_m)


def _force_signal(pair: Pair) -> Signal:
    description = (
        f"largest force between the arms of {' and '.join(map(agent_name, pair))}; 0 without contact"
    )

    def largest_n(execution: Execution) -> NDArray[np.float64]:
        contacts_by_scene = (scene.arm_contacts for scene in execution.scenes)
        forces_n = ([n for a, b, n in contacts if {a, b} == {*pair}] for contacts in contacts_by_scene)
        return np.array([max(forces, default=0.0) for forces in forces_n])

    return Signal(identifier("force", *pair), "N", description, largest_n)


def contact_evidence(
    separation: Separation, scene: Scene, pairs: tuple[Pair, ...], may_touch: Touches
) -> Evidence | None:
    """The first pair of arms that touch: contact force from the simulator, or overlapping volume."""
    return force_evidence(scene, pairs) or overlap_evidence(separation, scene, pairs, may_touch)


def force_evidence(scene: Scene, pairs: tuple[Pair, ...]) -> Evidence | None:
    """The first pair of arms whose contact force in the simulator exceeds CONTACT_N."""
    for a, b, force_n in scene.arm_contacts:
        if tuple(sorted((a, b))) in pairs and force_n > CONTACT_N:
            facts: FactArguments = {"measured": True, "agents": (a, b)}
            return Evidence(Finding.TOUCHING, force_n, CONTACT_N, "N", ok=False, time_s=scene.time_s, **facts)
    return None


def protective_stop(scene: Scene) -> bool:
    """Whether two arms press on one another so hard that both stop."""
    return any(force_n > STOP_N for *_, force_n in scene.arm_contacts)


def overlap_evidence(
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
            facts: FactArguments = {"measured": True, "agents": pair, "parts": (gap.a, gap.b)}
            return Evidence(Finding.OVERLAPPING, gap.distance_m, ok=False, time_s=scene.time_s, **facts)
    return None


@dataclass(frozen=True)
class AvoidObjectsCheck(Check):
    """Agents touch neither the table nor objects that their segments do not involve. Value, bound in metres.

    Judged before execution: measured contacts with objects may be wanted or not, and the monitor finds an
    agent that strays from its path.
    """

    statement_type, name, unit = AvoidObjects, CheckName.OCCUPANCY, "m"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VSO({agent_names(self.agents)}, objects)"

    def planned(self, plan: Plan) -> Evidence:
        closest = self.not_applicable(plan, OBJECT_MARGIN_M, np.inf)
        for agent in self.agents:
            body, obstacles = plan.paths.swept[agent - 1], plan.paths.static_obstacles[agent - 1]
            positions = np.unique(plan.positions(agent))
            hits = positions[plan.paths.blocked[agent - 1][positions]]
            if len(hits):
                return self._collision_evidence(plan, agent, int(hits[0]), body, obstacles)
            gap = nearest(body, obstacles, np.stack([positions, 0 * positions], axis=1))
            if gap.distance_m < closest.value:
                facts: FactArguments = {"agents": (agent,), "obstacles": (gap.b,)}
                numbers = gap.distance_m, OBJECT_MARGIN_M, plan.time_s(agent, gap.at[0])
                closest = self.make_evidence(True, Finding.CLEAR_OF_THING, *numbers, **facts)
        return closest

    def _collision_evidence(
        self, plan: Plan, agent: int, position: int, body: Swept, obstacles: Swept
    ) -> Evidence:
        refined = plan.paths.refined(agent)
        rows = np.arange(len(refined))[plan.paths.refined_slice(position)]
        gap = nearest(refined, obstacles, np.stack([rows, 0 * rows], axis=1))
        height_m = float(lowest_m(body)[position])
        part, obstacle, value = "arm", "the table", height_m
        if gap.a and (height_m >= 0 or gap.distance_m < height_m):
            part, obstacle, value = gap.a, gap.b, gap.distance_m
        numbers = value, OBJECT_MARGIN_M, plan.time_s(agent, position)
        activities = plan.doing((agent,), (position,))
        facts: FactArguments = {
            "agents": (agent,),
            "obstacles": (obstacle,),
            "parts": (part,),
            "doing": activities,
        }
        return self.make_evidence(False, Finding.CLOSE_TO_THING, *numbers, **facts)

    def stl(self, task: Task) -> Specification:
        clearances = [_clearance_signal(agent) for agent in self.agents]
        heights = [_height_signal(agent) for agent in self.agents]
        objects = always([f"{signal.name} >= {OBJECT_MARGIN_M!r}" for signal in clearances], "m")
        # A formula of its own: grippers are nearer to the table than to objects, whose margins it would hide.
        table = always([f"{signal.name} >= {TABLE_MARGIN_M!r}" for signal in heights], "m")
        return Specification((objects, table), (*clearances, *heights), measured=False)


def _clearance_signal(agent: int) -> Signal:
    def clearance_m(execution: Execution) -> NDArray[np.float64]:
        paths, positions = execution.plan.paths, execution.positions(agent)
        body, obstacles = paths.swept[agent - 1], paths.static_obstacles[agent - 1]
        heights_m, clearances_m = lowest_m(body), {}
        for position in np.unique(positions).tolist():
            gap_m = nearest(body, obstacles, np.array([[position, 0]])).distance_m
            clearances_m[position] = min(gap_m, 2 * MAX_MARGIN)  # still MAX_MARGIN less the margin
            # Flagged, and not because of the table: too close to an obstacle.
            if paths.blocked[agent - 1][position] and heights_m[position] >= TABLE_MARGIN_M:
                clearances_m[position] = min(clearances_m[position], np.nextafter(OBJECT_MARGIN_M, 0.0))
        return np.array([clearances_m[position] for position in positions.tolist()])

    description = (
        f"from {agent_name(agent)} where it is commanded to what nobody moves and it may not touch; "
        "less than the margin where the motion to the next step may be"
    )
    return Signal(identifier("clearance", agent), "m", description, clearance_m)


def _height_signal(agent: int) -> Signal:
    def heights_m(execution: Execution) -> NDArray[np.float64]:
        return lowest_m(execution.plan.paths.swept[agent - 1])[execution.positions(agent)]

    description = (
        f"lowest point of {agent_name(agent)} where it is commanded, with what it carries, over the table"
    )
    return Signal(identifier("lowest", agent), "m", description, heights_m)
