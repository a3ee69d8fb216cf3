"""Places that are taken: what a proposal puts where it would overlap something else, told before planning.

Counted are things that stay where they stand, as no subgoal is about them, and what is put elsewhere once.
How a thing is turned there, and how far beside it may lie, is chosen so that it overlaps least.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product

import numpy as np

from rf_exp.datagen.motion import Unreachable, destinations
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.geometry import PlanningScene, Swept, overlap
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, Subgoal


@dataclass(frozen=True)
class _Put:
    """A thing, and the poses of it that a subgoal may lead to."""

    subgoal: Subgoal
    name: str
    poses: Sequence[Matrix]  # world_from_object


def taken(task: Task, proposal: Proposal, scene: Scene) -> Violation | None:
    """The first place that is taken, by what and by how much; None where there is room for everything."""
    puts = list(_puts(task, proposal, scene))
    about = {subgoal.object for subgoal in proposal.subgoals}
    stay = [name for name in task.objects if name not in about and name not in scene.held]
    for put in puts:
        for name in stay:
            if name != put.subgoal.target:
                depth_m = _least_depth_m(task, scene, put, name, [scene.poses[name]])
                if depth_m > 0:
                    return _violation(scene, put, name, depth_m)
    once = [put for put in puts if [each.name for each in puts].count(put.name) == 1]
    for put, other in combinations(once, 2):
        depth_m = _least_depth_m(task, scene, put, other.name, other.poses)
        if depth_m > 0:
            return _violation(scene, put, f"{other.name} at {other.subgoal.target}", depth_m)
    return None


def _puts(task: Task, proposal: Proposal, scene: Scene) -> Iterator[_Put]:
    """What is put where, but on things that are moved themselves, which are nobody knows yet where."""
    moved = {subgoal.object for subgoal in proposal.subgoals}
    for subgoal in proposal.subgoals:
        name = subgoal.object
        if name is not None and subgoal.verb == "place" and subgoal.target not in moved:
            try:
                yield _Put(subgoal, name, destinations(task, subgoal, scene))
            except Unreachable:  # that will be said when its turn comes
                continue


def _least_depth_m(task: Task, scene: Scene, put: _Put, name: str, poses: Sequence[Matrix]) -> float:
    """How far a thing would be in another, however both are turned; 0 where they need not overlap."""
    least = np.inf
    reach_m = _radius_m(task.asset(put.name)) + _radius_m(task.asset(name))
    for one, other in product(put.poses, poses):
        if np.linalg.norm(one[:3, 3] - other[:3, 3]) >= reach_m:
            return 0.0
        in_hand = replace(_at(task, scene, put.name, one), carried={put.name: np.ones(1, dtype=bool)})
        gap = overlap(in_hand, _at(task, scene, name, other))
        if gap is None or gap.distance_m >= 0:
            return 0.0
        least = min(least, -gap.distance_m)
    return float(least)


def _at(task: Task, scene: Scene, name: str, pose: Matrix) -> Swept:
    return PlanningScene(task, replace(scene, poses={**scene.poses, name: pose})).standing([name])


@lru_cache(maxsize=1024)
def _radius_m(asset: Asset) -> float:
    """Of a sphere about the origin that holds all of it; of a mark none."""
    return max((float(np.linalg.norm(hull.vertices, axis=1).max()) for hull in asset.hulls), default=-np.inf)


def _violation(scene: Scene, put: _Put, obstacle: str, depth_m: float) -> Violation:
    return Violation(
        check=CheckName.MOTION,
        cause=Cause.SPACE,
        finding=Finding.TAKEN,
        value=-depth_m,
        unit="m",
        time_s=scene.time_s,
        agents=(put.subgoal.agent,),
        subgoals=(put.subgoal.text,),
        object=put.name,
        aspect=put.subgoal.target or "",
        obstacles=(obstacle,),
    )
