"""Requests to motion primitives, goal poses of held objects, and the look-ahead beyond a grasp or placement.

The cost of what follows a motion is estimated, so that objects are grasped and placed where that is feasible
and fast.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import takewhile

import numpy as np

from rf_exp.datagen.motion.branches import Arrivals
from rf_exp.datagen.motion.reach import (
    LookAhead,
    Reach,
    Tiers,
    above,
    contact_poses,
    drawn_back,
    symmetric_poses,
)
from rf_exp.datagen.motion.state import Floats, Points, State, Unreachable
from rf_exp.datagen.yielding import posture_rad
from rf_exp.findings import Cause, Finding
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import GRIPPER_CLOSED, Scene, Segment, Subgoal

STRIKE_M = 0.002  # depth to which a tool is driven into what it strikes; the arm is compliant
DROP_M = 0.004  # height above the place of a release, so that nothing is pressed into the table
_FACE_FROM_TOOL = np.diag([1.0, -1.0, -1.0, 1.0])  # from a face, z up, to a tool that works on it, z down
_STRIKE_ROTATIONS = 16
_NAMED_PLACE = InteractionPoint(np.eye(4), "place", turns=12)  # where the rotation of an object is free
DEFAULT_LIFT_M = 0.15  # height of a lift, where no subgoal tells it
CLEAR_SHARE = 0.7  # share of its way home after which an arm is in nobody's way
_HELD_VERBS = ("lift", "carry", "place", "strike")  # verbs that move the held object

Line = Callable[[Points], Points | None]  # from joint points (K, dof) of a motion to those of the next


@dataclass(frozen=True)
class Request:
    """Request to a motion primitive: a subgoal, and the ones that remain after it."""

    task: Task
    reach: Reach
    subgoal: Subgoal
    following: Sequence[Subgoal] = ()  # of the same agent
    of_others: Sequence[Subgoal] = ()  # remaining ones of the other agents

    @property
    def agent(self) -> int:
        return self.subgoal.agent

    def taker(self, name: str) -> Subgoal | None:
        """The grasp of the agent that takes an object next from where this one puts it down."""
        return next((each for each in self.of_others if (each.verb, each.object) == ("grasp", name)), None)

    def tcp(self, state: State) -> Matrix:
        """world_from_tcp of the agent."""
        return self.reach.arms[self.agent].tcp(state.qpos[self.agent])

    def segment(
        self,
        primitive: str,
        points: Points,
        state: State,
        touches: frozenset[str] = frozenset(),
        joined: str | None = None,
    ) -> tuple[Segment, State]:
        """A segment along timed points (T, dof), with the held object, and the state at its end."""
        agent = self.agent
        name, tcp_from_object = state.held.get(agent, (None, None))
        gripper = np.full(len(points), state.gripper[agent])
        if len(points):
            state = replace(state, qpos={**state.qpos, agent: points[-1]})
            if name is not None and tcp_from_object is not None:
                state = replace(state, poses={**state.poses, name: self.tcp(state) @ tcp_from_object})
        touches = touches | state.in_hand(agent)
        segment = Segment(
            agent, self.subgoal, primitive, points, gripper, name, tcp_from_object, touches, joined
        )
        return segment, state


def end_poses(task: Task, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> Tiers:
    """TCP poses at which a held object has been carried, placed or struck as the subgoal says.

    A carried or placed object may be rotated as the place allows and, where nothing else is reachable, offset
    towards the arm by the slack of the place. Raises Unreachable for a target or point that does not exist.
    """
    world_from_target, point = _target_pose(task, subgoal, state)
    if subgoal.verb in ("carry", "place"):
        height_m = DROP_M if subgoal.verb == "place" else subgoal.height_m or 0.0
        towards_arm = task.arms[subgoal.agent].world_from_base[:2, 3] - world_from_target[:2, 3]
        towards_arm /= np.linalg.norm(towards_arm)
        tiers = []
        for offset_m in (0.0, point.slack_m / 2, point.slack_m) if point.slack_m else (0.0,):
            raised = above(world_from_target, height_m)
            raised[:2, 3] += offset_m * towards_arm
            tiers.append([pose @ inverse(tcp_from_object) for pose in symmetric_poses(raised, point.turns)])
        return tiers
    tool = task.asset(subgoal.object or "").points[subgoal.point or ""]
    face = world_from_target @ transform((0.0, 0.0, -STRIKE_M))
    face_from_tcp = _FACE_FROM_TOOL @ inverse(tcp_from_object @ tool.object_from_tcp)
    return [[pose @ face_from_tcp for pose in symmetric_poses(face, _STRIKE_ROTATIONS)]]


def destinations(task: Task, subgoal: Subgoal, scene: Scene) -> Sequence[Matrix]:
    """The poses world_from_object in which a subgoal may put its object in the present scene."""
    state = State({}, {}, {}, scene.poses, task.places(scene))
    return [pose for tier in end_poses(task, subgoal, state, np.eye(4)) for pose in tier]


def support(task: Task, subgoal: Subgoal) -> frozenset[str]:
    """The object on which another is placed; none where it is dropped into one."""
    target = subgoal.target
    if target is None or target not in task.objects or _placing(task, subgoal).kind == "drop":
        return frozenset()
    return frozenset({target})


def _target_pose(task: Task, subgoal: Subgoal, state: State) -> tuple[Matrix, InteractionPoint]:
    """world_from_object of the object once placed, and the point that defines its freedom."""
    target = subgoal.target or ""
    if target in state.places:
        return state.places[target], _NAMED_PLACE
    if target not in state.poses:
        known = tuple(sorted([*state.places, *state.poses]))
        raise Unreachable(Cause.REACH, Finding.NO_TARGET, (subgoal.agent,), aspect=target, known=known)
    point = _placing(task, subgoal)
    return state.poses[target] @ point.object_from_tcp, point


def _placing(task: Task, subgoal: Subgoal) -> InteractionPoint:
    """The point of the target object at which another is placed or dropped."""
    placing = task.asset(subgoal.target or "").placement_points
    name = subgoal.target_point or next(iter(placing), None)
    if name is None or name not in placing:
        facts = {"object": subgoal.target, "aspect": name or "", "known": tuple(sorted(placing))}
        finding = Finding.NO_POINT if placing or name else Finding.NO_PLACE
        raise Unreachable(Cause.REACH, finding, (subgoal.agent,), **facts)
    return placing[name]


def after_grasp(request: Request, name: str, state: State) -> LookAhead:
    """Look-ahead of a grasp: what the agent does with the object, until it has let go and is at rest."""

    def cost_to_go(goals: Floats) -> Callable[[int, Points], float]:
        @cache
        def lines(goal: int) -> Sequence[Line]:
            return tuple(_held_motions(request, name, inverse(goals[goal]) @ state.poses[name], state))

        return lambda goal, points: _total_duration_s(request.reach, lines(goal), points)

    return LookAhead(cost_to_go, can_continue=partial(_can_rise, request, name, state))


def _can_rise(request: Request, name: str, state: State, joints: Points) -> bool:
    """Whether the arm can raise what it grasps at joints (dof,), if it has to carry or place it next."""
    following = next(iter(request.following), None)
    if following is None or following.verb not in ("carry", "place"):
        return True
    agent, reach = request.agent, request.reach
    gripper = {**state.gripper, agent: GRIPPER_CLOSED}
    grasped = replace(state, qpos={**state.qpos, agent: joints}, gripper=gripper)
    tcp_from_object = inverse(request.tcp(grasped)) @ state.poses[name]
    grasped = replace(grasped, held={**grasped.held, agent: (name, tcp_from_object)})
    touches, line = grasped.in_hand(agent) | support(request.task, following), reach.rise_line(agent, joints)
    return line is None or reach.blocked(agent, line, grasped, touches, between=True) is None


def after_placement(request: Request, state: State) -> LookAhead:
    """Look-ahead of a placement: the agent retreats to rest, or leaves the object to its taker."""
    name, tcp_from_object = state.held[request.agent]
    taker = request.taker(name)
    rest = posture_rad("home", request.task, request.agent)
    duration_s = request.reach.duration_s

    def cost_to_go(goals: Floats) -> Callable[[int, Points], float]:
        takeover_s = None if taker is None else _takeover_s(request, taker, goals @ tcp_from_object, state)

        def duration_s_of_goal(goal: int, points: Points) -> float:
            back_s, home_s = duration_s(points[:-3:-1]), duration_s(np.stack([points[-2], rest]))
            wait_s = home_s if takeover_s is None else max(CLEAR_SHARE * home_s, takeover_s[goal])
            return float(back_s + wait_s)

        return duration_s_of_goal

    return LookAhead(cost_to_go, rest if taker is None else None)


def _held_motions(request: Request, name: str, tcp_from_object: Matrix, state: State) -> Iterator[Line]:
    """The motions of the subgoals that move the object; a lift, where a later proposal decides on them."""
    reach, agent = request.reach, request.agent
    held_subgoals = [
        *takewhile(lambda each: each.object == name and each.verb in _HELD_VERBS, request.following)
    ]
    rest = None  # with a taker: nobody waits until the giver is at rest
    if request.taker(name) is None:
        rest = posture_rad("home", request.task, agent)
    if not held_subgoals:
        yield partial(_lift_line, reach, agent, DEFAULT_LIFT_M)
    for subgoal in held_subgoals:
        if subgoal.verb == "lift":
            assert subgoal.height_m is not None  # ensured by `read_subgoal`
            yield partial(_lift_line, reach, agent, subgoal.height_m)
            continue
        try:
            tiers = end_poses(request.task, subgoal, state, tcp_from_object)
        except Unreachable:  # raised again when that subgoal is planned
            return
        if subgoal.verb != "place":
            yield reach.arrivals(agent, tiers)
            continue
        # Back the way it came, and to rest.
        yield reach.arrivals(agent, tiers, rest)
        yield lambda points: points[:-3:-1]
        if rest is not None:
            yield lambda points: np.stack([points[-1], rest])
        return


def _takeover_s(request: Request, taker: Subgoal, poses: Floats, state: State) -> Floats:
    """(G,) s that an agent takes to grasp an object at world_from_object (G, 4, 4); infinite: it cannot."""
    name = taker.object or ""
    point = request.task.asset(name).points[taker.point or ""]
    tcp_poses = contact_poses(np.eye(4), point)
    goals = np.stack([pose @ tcp_pose for pose in poses for tcp_pose in tcp_poses])
    arm, pregrasps = request.reach.arms[taker.agent], drawn_back(goals, point.standoff_m)
    corners = Arrivals(arm, pregrasps, goals).nearest(state.qpos[taker.agent])
    return request.reach.duration_s(corners).reshape(len(poses), -1).min(axis=1)


def _lift_line(reach: Reach, agent: int, height_m: float, points: Points) -> Points | None:
    joints = points[-1]
    return reach.line(agent, joints, above(reach.arms[agent].tcp(joints), height_m))


def _total_duration_s(reach: Reach, lines: Sequence[Line], points: Points) -> float:
    """Duration of successive motions after one along (K, dof); infinite where one does not exist."""
    total_s = 0.0
    for line in lines:
        motion = line(points)
        if motion is None:
            return np.inf
        total_s, points = total_s + float(reach.duration_s(motion)), motion
    return total_s
