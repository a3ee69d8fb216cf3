"""Where an object in the hand is to go: TCP poses that carry, place or strike with it."""

from collections.abc import Sequence

import numpy as np

from rf_exp.datagen.motion.reach import Tiers, above, turned
from rf_exp.datagen.motion.state import State, Unreachable
from rf_exp.findings import Cause, Finding
from rf_exp.robots import Arm
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import Scene, Subgoal

STRIKE_M = 0.002  # a tool is driven so far into what it strikes; the arm is compliant
DROP_M = 0.004  # let go this far above the place, so that nothing is pressed into the table
_FACING = np.diag([1.0, -1.0, -1.0, 1.0])  # from a face, z up, to a tool that works on it, z down
_STRIKE_TURNS = 16
_SPOT = InteractionPoint(np.eye(4), "place", turns=12)  # a named place: how a thing is turned there is free


def ends(task: Task, arm: Arm, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> Tiers:
    """TCP poses in which an object held so has been carried, placed or struck as the subgoal says.

    Raises Unreachable for a target or point that does not exist.
    """
    if subgoal.verb == "carry":
        return _over(task, arm, subgoal, state, tcp_from_object, subgoal.height_m or 0.0)
    if subgoal.verb == "place":
        return _over(task, arm, subgoal, state, tcp_from_object, DROP_M)
    tool = task.asset(subgoal.object or "").points[subgoal.point or ""]
    world_from_target, _ = _destination(task, subgoal, state)
    face = world_from_target @ transform((0.0, 0.0, -STRIKE_M))
    grip = _FACING @ inverse(tcp_from_object @ tool.object_from_tcp)
    return [[pose @ grip for pose in turned(face, _STRIKE_TURNS)]]


def destinations(task: Task, subgoal: Subgoal, scene: Scene) -> Sequence[Matrix]:
    """The poses world_from_object that a subgoal may put its object in, as the scene is now.

    Raises Unreachable as `ends` does.
    """
    state = State({}, {}, {}, scene.poses, task.places(scene))
    tiers = ends(task, task.arms[subgoal.agent], subgoal, state, np.eye(4))
    return [pose for tier in tiers for pose in tier]


def support(task: Task, subgoal: Subgoal) -> frozenset[str]:
    """The object on which something is placed; none where it is dropped into one."""
    target = subgoal.target
    if target is None or target not in task.objects or _placing(task, subgoal).kind == "drop":
        return frozenset()
    return frozenset({target})


def _over(
    task: Task, arm: Arm, subgoal: Subgoal, state: State, tcp_from_object: Matrix, height_m: float
) -> Tiers:
    """TCP poses that put the held object at its destination, raised by `height_m`; best tier first.

    It may be turned as the place allows, and where nothing else is reachable stand off towards the arm
    by the slack of the place.
    """
    world_from_object, point = _destination(task, subgoal, state)
    towards_arm = arm.world_from_base[:2, 3] - world_from_object[:2, 3]
    towards_arm /= np.linalg.norm(towards_arm)
    tiers = []
    for offset_m in (0.0, point.slack_m / 2, point.slack_m) if point.slack_m else (0.0,):
        raised = above(world_from_object, height_m)
        raised[:2, 3] += offset_m * towards_arm
        tiers.append([pose @ inverse(tcp_from_object) for pose in turned(raised, point.turns)])
    return tiers


def _destination(task: Task, subgoal: Subgoal, state: State) -> tuple[Matrix, InteractionPoint]:
    """world_from_object of the thing once it has been placed, and the point that says how freely."""
    target = subgoal.target or ""
    if target in state.places:
        return state.places[target], _SPOT
    if target not in state.poses:
        known = tuple(sorted([*state.places, *state.poses]))
        raise Unreachable(Cause.REACH, Finding.NO_TARGET, (subgoal.agent,), aspect=target, known=known)
    point = _placing(task, subgoal)
    return state.poses[target] @ point.object_from_tcp, point


def _placing(task: Task, subgoal: Subgoal) -> InteractionPoint:
    """The point of the target object at which something is placed or dropped."""
    points = task.asset(subgoal.target or "").points
    placing = {name: point for name, point in points.items() if point.kind in ("place", "drop")}
    name = subgoal.target_point or next(iter(placing), None)
    if name not in placing:
        about = {"object": subgoal.target, "aspect": name or "", "known": tuple(sorted(placing))}
        finding = Finding.NO_POINT if placing or name else Finding.NO_PLACE
        raise Unreachable(Cause.REACH, finding, (subgoal.agent,), **about)
    return placing[name]
