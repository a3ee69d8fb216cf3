"""Obstacles of motions, as far as the set of constraints lets the planner see them, and occupied places."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product
from typing import Any

import numpy as np

from rf_exp.datagen.motion.request import destinations, support
from rf_exp.datagen.motion.state import Blockage, Blocked, Obstacle, Points, State, Unreachable, obstacle_name
from rf_exp.findings import Cause, CheckName, FactArguments, Finding, Violation
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    PlanningScene,
    Swept,
    closer_than,
    merged,
    nearest,
    self_collisions,
)
from rf_exp.perception import UNKNOWN_OBSTACLE, OccupancyMap
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix
from rf_exp.types import ConstraintSet, Scene, Subgoal, fingers_of

ObstacleGroup = tuple[Sequence[Obstacle], Swept, float]  # obstacles, their joined body, clearance in m


class Obstacles:
    """Static obstacles of a planner: objects, table and arms as in the predicted state.

    Without spatial constraints only the objects of the present subgoal and the table are obstacles. Where
    depth cameras have observed the scene, so are the voxels that they see.
    """

    def __init__(self, task: Task, scene: Scene, constraint_set: ConstraintSet, proposal: Proposal) -> None:
        self._task, self._scene, self._constraint_set, self._proposal = task, scene, constraint_set, proposal
        self._seen = OccupancyMap(PlanningScene(task, scene)) if scene.occupied_voxels is not None else None
        # Cached, as a path search queries the same state over and over.
        self._surroundings = lru_cache(maxsize=1)(self._find_obstacles)

    def blocked(self, *, avoid_arms: bool) -> Blocked:
        """The collision test of motion primitives; with `avoid_arms`, arms at rest are obstacles too."""

        def test(
            agent: int,
            points: Points,
            state: State,
            touches: frozenset[str],
            *,
            between: bool = False,
            gripper_only: bool = False,
        ) -> Obstacle | None:
            planning_scene, groups = self._surroundings(agent, state, touches, avoid_arms)
            body = _body(planning_scene, agent, points, state, touches)
            if gripper_only:
                body = body.only(*body.gripper, *body.objects)
                groups = [each for each in groups if not isinstance(each[0][0], int)]
            elif self_collisions(body, self._task.arms[agent].robot.self_pairs).any():
                return "the arm itself"
            for obstacles, other, margin_m in groups:
                if closer_than(body, other, margin_m, between=between).any():
                    parts = ((each, _part_of(planning_scene, other, each)) for each in obstacles[:-1])
                    near = (
                        each
                        for each, part in parts
                        if closer_than(body, part, margin_m, between=between).any()
                    )
                    return next(near, obstacles[-1])
            return "the table" if not gripper_only and planning_scene.below_table(body).any() else None

        return test

    def distance_facts(self, blockage: Blockage) -> dict[str, Any]:
        """The nearest parts and their distance, as `FindingFacts`; none for the arm itself or table."""
        agent, state, touches, obstacle = blockage.agent, blockage.state, blockage.touches, blockage.obstacle
        planning_scene, groups = self._surroundings(agent, state, touches, True)
        body = _body(planning_scene, agent, blockage.points, state, touches)
        for obstacles, other, margin_m in groups:
            if obstacle in obstacles and (gap := nearest(body, _part_of(planning_scene, other, obstacle))).a:
                facts = {"value": gap.distance_m, "bound": margin_m, "unit": "m"}
                other_part = f"{gap.b} of {obstacle_name(obstacle)}" if isinstance(obstacle, int) else gap.b
                return {**facts, "parts": (gap.a, other_part), "aspect": blockage.where}
        return {}

    def _find_obstacles(
        self, agent: int, state: State, touches: frozenset[str], avoid_arms: bool
    ) -> tuple[PlanningScene, Sequence[ObstacleGroup]]:
        """The predicted scene and its obstacles; many are joined into one body, as mostly none is near."""
        qpos = self._scene.qpos.copy()
        for each, joints in state.qpos.items():
            qpos[each - 1, : len(joints)] = joints
            fingers_of(qpos)[each - 1] = self._task.arms[each].robot.hand.open_m
        held = tuple(state.held.get(agent, (None,))[0] for agent in self._task.agents)
        scene = replace(self._scene, qpos=qpos, poses=dict(state.poses), held=held)
        planning_scene, groups = PlanningScene(self._task, scene), list[ObstacleGroup]()
        spatial = self._constraint_set.spatial
        names = [*self._task.objects, *self._task.clutter] if spatial else sorted(state.targets)
        if self._seen is not None and spatial:
            boxes, exact_objects = self._seen.obstacles(agent, self._ignored_objects(agent, state) | touches)
            names = sorted(exact_objects)
            groups.append(([UNKNOWN_OBSTACLE], boxes, OBJECT_MARGIN_M))
        if others := [name for name in names if name not in state.in_hand(agent)]:
            groups.append((others, planning_scene.static_objects(others), OBJECT_MARGIN_M))
        arms = [other for other in self._task.agents if avoid_arms and spatial and other != agent]
        if unloaded := [other for other in arms if other not in state.held]:
            groups.append((unloaded, merged([*map(planning_scene.measured, unloaded)]), AGENT_MARGIN_M))
        loaded = (other for other in arms if other in state.held)  # an agent may touch a load it takes over
        groups += [([other], planning_scene.measured(other), AGENT_MARGIN_M) for other in loaded]
        return planning_scene, groups

    def _ignored_objects(self, agent: int, state: State) -> frozenset[str]:
        """Objects whose voxels the agent ignores: those of its subgoals, and held or recently moved ones."""
        about = {name for subgoal in self._proposal.subgoals_of(agent) for name in subgoal.names}
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


def _part_of(planning_scene: PlanningScene, body: Swept, obstacle: Obstacle) -> Swept:
    """The part of a joined body that is one object or arm."""
    return planning_scene.measured(obstacle) if isinstance(obstacle, int) else body.only(obstacle)


@dataclass(frozen=True)
class _Placement:
    """An object, and the poses in which a subgoal may put it."""

    subgoal: Subgoal
    name: str
    poses: Sequence[Matrix]  # world_from_object


def occupied_place(task: Task, proposal: Proposal, scene: Scene) -> Violation | None:
    """The first place that is occupied, with obstacle and depth; None where everything fits.

    Obstacles are objects that stay, as no subgoal moves them and no arm holds them, and other objects that
    are placed once. Of the permitted rotations and offsets at a place, those with the least overlap count.
    """
    placements = list(_placements(task, proposal, scene))
    moved = {subgoal.object for subgoal in proposal.subgoals}
    stationary = [name for name in task.objects if name not in moved and name not in scene.held]
    for placement in placements:
        for name in stationary:
            if name == placement.subgoal.target:
                continue
            depth_m = _min_penetration_m(task, scene, placement, name, [scene.poses[name]])
            if depth_m > 0:
                return _occupied(scene, placement, name, depth_m)
    names = [each.name for each in placements]
    placed_once = [each for each in placements if names.count(each.name) == 1]
    for placement, other in combinations(placed_once, 2):
        is_dropped = [not support(task, each.subgoal) for each in (placement, other)]
        if placement.subgoal.target == other.subgoal.target and any(is_dropped) and not all(is_dropped):
            continue  # a dropped object comes to rest below its release pose, a lid above
        depth_m = _min_penetration_m(task, scene, placement, other.name, other.poses)
        if depth_m > 0:
            return _occupied(scene, placement, f"{other.name} at {other.subgoal.target}", depth_m)
    return None


def _placements(task: Task, proposal: Proposal, scene: Scene) -> Iterator[_Placement]:
    """The objects that subgoals place, except on targets that are moved too, at poses not known yet."""
    moved = {subgoal.object for subgoal in proposal.subgoals}
    for subgoal in proposal.subgoals:
        name = subgoal.object
        if name is not None and subgoal.verb == "place" and subgoal.target not in moved:
            try:
                yield _Placement(subgoal, name, destinations(task, subgoal, scene))
            except Unreachable:  # raised again when that subgoal is planned
                continue


def _min_penetration_m(
    task: Task, scene: Scene, placement: _Placement, name: str, poses: Sequence[Matrix]
) -> float:
    """The least penetration of two objects over all their poses; 0 where some poses do not overlap."""
    min_m = np.inf
    placed = placement.name
    reach_m = _radius_m(task.asset(placed)) + _radius_m(task.asset(name))
    for pose, other in product(placement.poses, poses):
        if np.linalg.norm(pose[:3, 3] - other[:3, 3]) >= reach_m:
            return 0.0
        held_body = replace(body_at(task, scene, placed, pose), carried={placed: np.ones(1, dtype=bool)})
        gap_m = nearest(held_body, body_at(task, scene, name, other)).distance_m
        if gap_m >= 0:
            return 0.0
        min_m = min(min_m, -gap_m)
    return float(min_m)


def body_at(task: Task, scene: Scene, name: str, pose: Matrix) -> Swept:
    """The body of an object at world_from_object."""
    return PlanningScene(task, replace(scene, poses={**scene.poses, name: pose})).static_objects([name])


@lru_cache(maxsize=1024)
def _radius_m(asset: Asset) -> float:
    """Radius of the bounding sphere about the origin; -inf for a mark, which has no hulls."""
    return max((float(np.linalg.norm(hull.vertices, axis=1).max()) for hull in asset.hulls), default=-np.inf)


def _occupied(scene: Scene, placement: _Placement, obstacle: str, depth_m: float) -> Violation:
    subgoal, target = placement.subgoal, placement.subgoal.target or ""
    facts: FactArguments = {
        "agents": (subgoal.agent,),
        "subgoals": (subgoal.text,),
        "object": placement.name,
        "aspect": target,
    }
    facts["obstacles"] = (obstacle,)
    time_s = scene.time_s
    return Violation(
        Finding.TAKEN, -depth_m, unit="m", check=CheckName.MOTION, cause=Cause.SPACE, time_s=time_s, **facts
    )
