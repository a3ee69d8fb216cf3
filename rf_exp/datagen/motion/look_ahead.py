"""What comes after a motion, estimated: things are grasped and placed so that it can be done, and soon."""

from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import takewhile

import numpy as np

from rf_exp.datagen.motion.branches import Arrivals
from rf_exp.datagen.motion.reach import LookAhead, Reach, above, turned
from rf_exp.datagen.motion.request import Request, ends
from rf_exp.datagen.motion.state import Floats, Points, State, Unreachable
from rf_exp.datagen.yielding import posture_rad
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import Subgoal

Line = Callable[[Points], Points | None]  # from joint points (K, dof) of a motion to those of the next

EXPECTED_M = 0.15  # of a lift
AWAY = 0.7  # share of its way home after which an arm is in nobody's way
_WITH_HELD = ("lift", "carry", "place", "strike")  # verbs that move what is held


def once_grasped(request: Request, name: str, state: State) -> LookAhead:
    """What the agent does with the thing in its hand, until it has let go and is at rest."""

    def after(goals: Floats) -> Callable[[int, Points], float]:
        @cache
        def lines(goal: int) -> Sequence[Line]:
            return tuple(_with_held(request, name, inverse(goals[goal]) @ state.poses[name], state))

        return lambda goal, points: _takes_s(request.reach, lines(goal), points)

    return LookAhead(after)


def once_placed(request: Request, state: State) -> LookAhead:
    """The agent draws back, and goes to rest or leaves what it has placed to the one that takes it next."""
    name, tcp_from_object = state.held[request.agent]
    taker = request.taker(name)
    rest = posture_rad("home", request.task, request.agent)
    duration_s = request.reach.duration_s

    def after(goals: Floats) -> Callable[[int, Points], float]:
        taken_s = None if taker is None else _taken_s(request, taker, goals @ tcp_from_object, state)

        def takes_s(goal: int, points: Points) -> float:
            back_s, home_s = duration_s(points[:-3:-1]), duration_s(np.stack([points[-2], rest]))
            return float(back_s + (home_s if taken_s is None else max(AWAY * home_s, taken_s[goal])))

        return takes_s

    return LookAhead(after, rest if taker is None else None)


def _with_held(request: Request, name: str, tcp_from_object: Matrix, state: State) -> Iterator[Line]:
    """The motions of the subgoals that move the thing; a lift, where a later proposal will say what comes."""
    reach, agent = request.reach, request.agent
    moving = [*takewhile(lambda each: each.object == name and each.verb in _WITH_HELD, request.following)]
    rest = None  # nobody waits until a giver is there
    if request.taker(name) is None:
        rest = posture_rad("home", request.task, agent)
    if not moving:
        yield partial(_lifted, reach, agent, EXPECTED_M)
    for each in moving:
        if each.verb == "lift":
            assert each.height_m is not None  # parse_subgoal has seen to it
            yield partial(_lifted, reach, agent, each.height_m)
            continue
        try:
            tiers = ends(request.task, each, state, tcp_from_object)
        except Unreachable:  # that will be said when its turn comes
            return
        if each.verb != "place":
            yield reach.arrive(agent, tiers)
            continue
        # Back the way it came, and to rest.
        yield reach.arrive(agent, tiers, rest)
        yield lambda points: points[:-3:-1]
        if rest is not None:
            yield lambda points: np.stack([points[-1], rest])
        return


def _taken_s(request: Request, taker: Subgoal, poses: Floats, state: State) -> Floats:
    """(G,) s in which an agent grasps a thing at world_from_object (G, 4, 4); infinite: it cannot."""
    name = taker.object or ""
    point = request.task.asset(name).points[taker.point or ""]
    hands = turned(point.object_from_tcp, point.turns)
    goals = np.stack([pose @ hand for pose in poses for hand in hands])
    pregrasps = goals @ transform((0.0, 0.0, -point.standoff_m))
    found = Arrivals(request.reach.arms[taker.agent], pregrasps, goals).nearest(state.qpos[taker.agent])
    return request.reach.duration_s(found).reshape(len(poses), -1).min(axis=1)


def _lifted(reach: Reach, agent: int, height_m: float, points: Points) -> Points | None:
    joints = points[-1]
    return reach.line(agent, joints, above(reach.arms[agent].tcp(joints), height_m))


def _takes_s(reach: Reach, lines: Sequence[Line], points: Points) -> float:
    """How long motions take after one along (K, dof), one by one; infinite where one does not exist."""
    total_s = 0.0
    for line in lines:
        found = line(points)
        if found is None:
            return np.inf
        total_s, points = total_s + float(reach.duration_s(found)), found
    return total_s
