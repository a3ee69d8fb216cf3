"""Obstacles of motions, as far as the set of constraints lets the planner see them, and occupied places."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product
from typing import Any

import numpy as np

from rf_exp.datagen.motion.request import destinations, support
from rf_exp.datagen.motion.state import Blockage, Blocked, Obstacle, Points, State, Unreachable, name_of
from rf_exp.findings import About, Cause, CheckName, Finding, Violation
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    PlanningScene,
    Swept,
    closer_than,
    folded,
    joined,
    nearest,
)
from rf_exp.perception import SEEN, Seen
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix
from rf_exp.types import ConstraintSet, Scene, Subgoal, fingers_of

InTheWay = tuple[Sequence[Obstacle], Swept, float]  # obstacles, their joined body, clearance in m


class Obstacles:
    """Static obstacles of a planner: objects, table and arms as in the predicted state.

    Without spatial constraints only the objects of the present subgoal and the table are obstacles. Where
    depth cameras have observed the scene, so are the voxels that they see.
    """

    def __init__(self, task: Task, scene: Scene, constraint_set: ConstraintSet, proposal: Proposal) -> None:
        self._task, self._scene, self._constraint_set, self._proposal = task, scene, constraint_set, proposal
        self._seen = Seen(PlanningScene(task, scene)) if scene.seen is not None else None
        # Cached, as a path search queries the same state over and over.
        self._surroundings = lru_cache(maxsize=1)(self._looked_up)

    def blocked(self, *, avoid_arms: bool) -> Blocked:
        """The collision test of motion primitives; with `avoid_arms`, arms at rest are obstacles too."""

        def test(
            agent: int,
            points: Points,
            state: State,
            touches: frozenset[str],
            *,
            between: bool = False,
            hand: bool = False,
        ) -> Obstacle | None:
            planning_scene, in_the_way = self._surroundings(agent, state, touches, avoid_arms)
            body = _body(planning_scene, agent, points, state, touches)
            if hand:
                body = body.only(*body.gripper, *body.objects)
                in_the_way = [each for each in in_the_way if not isinstance(each[0][0], int)]
            elif folded(body, self._task.arms[agent].robot.self_pairs).any():
                return "the arm itself"
            for obstacles, other, margin_m in in_the_way:
                if closer_than(body, other, margin_m, between=between).any():
                    each = ((one, _only(planning_scene, other, one)) for one in obstacles[:-1])
                    near = (one for one, it in each if closer_than(body, it, margin_m, between=between).any())
                    return next(near, obstacles[-1])
            return "the table" if not hand and planning_scene.below_table(body).any() else None

        return test

    def how_near(self, blockage: Blockage) -> dict[str, Any]:
        """The nearest parts and their distance, as facts of a `Found`; none for the arm itself or table."""
        agent, state, touches, obstacle = blockage.agent, blockage.state, blockage.touches, blockage.obstacle
        planning_scene, in_the_way = self._surroundings(agent, state, touches, True)
        body = _body(planning_scene, agent, blockage.points, state, touches)
        for obstacles, other, margin_m in in_the_way:
            if obstacle in obstacles and (gap := nearest(body, _only(planning_scene, other, obstacle))).a:
                near = {"value": gap.distance_m, "bound": margin_m, "unit": "m"}
                other_part = f"{gap.b} of {name_of(obstacle)}" if isinstance(obstacle, int) else gap.b
                return {**near, "parts": (gap.a, other_part), "aspect": blockage.where}
        return {}

    def _looked_up(
        self, agent: int, state: State, touches: frozenset[str], avoid_arms: bool
    ) -> tuple[PlanningScene, Sequence[InTheWay]]:
        """The predicted scene and its obstacles; many are joined into one body, as mostly none is near."""
        qpos = self._scene.qpos.copy()
        for each, joints in state.qpos.items():
            qpos[each - 1, : len(joints)] = joints
            fingers_of(qpos)[each - 1] = self._task.arms[each].robot.hand.open_m
        held = tuple(state.held.get(agent, (None,))[0] for agent in self._task.agents)
        scene = replace(self._scene, qpos=qpos, poses=dict(state.poses), held=held)
        planning_scene, found = PlanningScene(self._task, scene), list[InTheWay]()
        spatial = self._constraint_set.spatial
        names = [*self._task.objects, *self._task.clutter] if spatial else sorted(state.targets)
        if self._seen is not None and spatial:
            boxes, exactly = self._seen.obstacles(agent, self._minds_not(agent, state) | touches)
            names = sorted(exactly)
            found.append(([SEEN], boxes, OBJECT_MARGIN_M))
        if others := [name for name in names if name not in state.in_hand(agent)]:
            found.append((others, planning_scene.standing(others), OBJECT_MARGIN_M))
        arms = [other for other in self._task.agents if avoid_arms and spatial and other != agent]
        if free := [other for other in arms if other not in state.held]:
            found.append((free, joined([*map(planning_scene.measured, free)]), AGENT_MARGIN_M))
        laden = (other for other in arms if other in state.held)  # an agent may touch a load it takes over
        found += [([other], planning_scene.measured(other), AGENT_MARGIN_M) for other in laden]
        return planning_scene, found

    def _minds_not(self, agent: int, state: State) -> frozenset[str]:
        """Objects whose voxels the agent ignores: those of its subgoals, and held or recently moved ones."""
        about = {name for subgoal in self._proposal.of(agent) for name in subgoal.names}
        held = {name for name, _ in state.held.values()}
        poses = self._scene.poses
        moved = {name for name, pose in state.poses.items() if not np.array_equal(pose, poses[name])}
        return frozenset((about | held | moved | state.targets) & set(self._task.objects))


def _body(
    planning_scene: PlanningScene, agent: int, points: Points, state: State, touches: frozenset[str]
) -> Swept:
    """The arm of an agent, with the object it holds, at joint points."""
    held, tcp_from_object = state.held.get(agent, (None, None))
    return planning_scene.arm(agent, points, attached=held, tcp_from_object=tcp_from_object, touches=touches)


def _only(planning_scene: PlanningScene, body: Swept, obstacle: Obstacle) -> Swept:
    """The part of a joined body that is one object or arm."""
    return planning_scene.measured(obstacle) if isinstance(obstacle, int) else body.only(obstacle)


@dataclass(frozen=True)
class _Put:
    """An object, and the poses in which a subgoal may put it."""

    subgoal: Subgoal
    name: str
    poses: Sequence[Matrix]  # world_from_object


def taken(task: Task, proposal: Proposal, scene: Scene) -> Violation | None:
    """The first place that is occupied, with obstacle and depth; None where everything fits.

    Obstacles are objects that stay, as no subgoal moves them and no arm holds them, and other objects that
    are placed once. Of the permitted rotations and offsets at a place, those with the least overlap count.
    """
    puts = list(_puts(task, proposal, scene))
    about = {subgoal.object for subgoal in proposal.subgoals}
    stay = [name for name in task.objects if name not in about and name not in scene.held]
    for put in puts:
        for name in stay:
            here = [scene.poses[name]]
            if name != put.subgoal.target and (depth_m := _least_depth_m(task, scene, put, name, here)) > 0:
                return _taken(scene, put, name, depth_m)
    once = [put for put in puts if [each.name for each in puts].count(put.name) == 1]
    for put, other in combinations(once, 2):
        falls = [not support(task, each.subgoal) for each in (put, other)]
        if put.subgoal.target == other.subgoal.target and any(falls) and not all(falls):
            continue  # a dropped object comes to rest below its release pose, a lid above
        depth_m = _least_depth_m(task, scene, put, other.name, other.poses)
        if depth_m > 0:
            return _taken(scene, put, f"{other.name} at {other.subgoal.target}", depth_m)
    return None


def _puts(task: Task, proposal: Proposal, scene: Scene) -> Iterator[_Put]:
    """The objects that subgoals place, except on targets that are moved too, at poses not known yet."""
    moved = {subgoal.object for subgoal in proposal.subgoals}
    for subgoal in proposal.subgoals:
        name = subgoal.object
        if name is not None and subgoal.verb == "place" and subgoal.target not in moved:
            try:
                yield _Put(subgoal, name, destinations(task, subgoal, scene))
            except Unreachable:  # raised again when that subgoal is planned
                continue


def _least_depth_m(task: Task, scene: Scene, put: _Put, name: str, poses: Sequence[Matrix]) -> float:
    """The least penetration of two objects over all their poses; 0 where some poses do not overlap."""
    least = np.inf
    reach_m = _radius_m(task.asset(put.name)) + _radius_m(task.asset(name))
    for one, other in product(put.poses, poses):
        if np.linalg.norm(one[:3, 3] - other[:3, 3]) >= reach_m:
            return 0.0
        in_hand = replace(placed_at(task, scene, put.name, one), carried={put.name: np.ones(1, dtype=bool)})
        gap_m = nearest(in_hand, placed_at(task, scene, name, other)).distance_m
        if gap_m >= 0:
            return 0.0
        least = min(least, -gap_m)
    return float(least)


def placed_at(task: Task, scene: Scene, name: str, pose: Matrix) -> Swept:
    """The body of an object at world_from_object."""
    return PlanningScene(task, replace(scene, poses={**scene.poses, name: pose})).standing([name])


@lru_cache(maxsize=1024)
def _radius_m(asset: Asset) -> float:
    """Radius of the bounding sphere about the origin; -inf for a mark, which has no hulls."""
    return max((float(np.linalg.norm(hull.vertices, axis=1).max()) for hull in asset.hulls), default=-np.inf)


def _taken(scene: Scene, put: _Put, obstacle: str, depth_m: float) -> Violation:
    about, at = put.subgoal, put.subgoal.target or ""
    facts: About = {"agents": (about.agent,), "subgoals": (about.text,), "object": put.name, "aspect": at}
    facts["obstacles"] = (obstacle,)
    time_s = scene.time_s
    return Violation(
        Finding.TAKEN, -depth_m, unit="m", check=CheckName.MOTION, cause=Cause.SPACE, time_s=time_s, **facts
    )
