"""Motion primitives: each subgoal becomes rest-to-rest segments of one agent (paper, supplementary A).

A primitive maps a request and the state that the previous one leaves to segments and the state that they
leave, so that a whole proposal is planned ahead of its execution.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from rf_exp.datagen.motion.reach import CLEARANCE_M, LookAhead, Tiers, above, contacts, drawn_back
from rf_exp.datagen.motion.request import Request, ends, once_grasped, once_placed, support
from rf_exp.datagen.motion.state import Blockage, Floats, Points, State, Unreachable, obstructed
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.yielding import posture_rad
from rf_exp.errors import ArgumentError, choices
from rf_exp.findings import Cause, Finding
from rf_exp.geometry import fallen
from rf_exp.statements import VERBS
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import CONTROL_HZ, GRIPPER_CLOSED, GRIPPER_OPEN, Segment

GRIPPER_STEPS = 8  # control steps that closing or opening takes, 0.4 s
RETREAT_M = 0.08
FAR_M = 0.3  # bound on the distance from the origin of an object to its interaction points
PRESS_ON_M = 0.004  # deeper, where pressing was not enough
STANDS_M = 0.003  # tolerance for a gripper to be at a pose
FINGER_M = 0.05  # lever that converts this tolerance into one of rotation
ARC_RAD = 0.05  # between postures of a sweep, at most
_TIPS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)

T = TypeVar("T")
Motion = tuple[tuple[Segment, ...], State]
Primitive = Callable[[Request, State], Motion]


def plan(request: Request, state: State) -> Motion:
    """The segments of one subgoal, and the state they leave. Raises Unreachable."""
    about = frozenset({*request.task.objects} & {request.subgoal.object, request.subgoal.target})
    verb = request.subgoal.verb
    if verb not in _PRIMITIVES:
        told = f"verb {verb!r} has no motion primitive"
        raise ArgumentError(f"{told}; rf_exp.datagen.add_primitive gives it one")
    return _PRIMITIVES[verb](request, replace(state, targets=about))


def grasp(request: Request, state: State) -> Motion:
    agent, name = request.agent, _required(request.subgoal.object)
    if agent in state.held:
        if state.held[agent][0] == name:
            return (), state
        raise Unreachable(Cause.GRIP, Finding.HOLDS_OTHER, (agent,), object=state.held[agent][0])
    point, tiers = _met(request, state)
    touches = frozenset({name})
    what, after, round_it = request.subgoal.text, once_grasped(request, name, state), point.around > 1
    points = request.reach.timed(
        agent, tiers, point.standoff_m, state, touches, what, round_it=round_it, look_ahead=after
    )
    approach, state = request.segment("approach", points, state, touches)
    close, state = _fingers(request, "close", GRIPPER_CLOSED, state, touches)
    tcp_from_object = inverse(request.tcp(state)) @ state.poses[name]
    return (approach, close), replace(state, held={**state.held, agent: (name, tcp_from_object)})


def lift(request: Request, state: State) -> Motion:
    line = lift_line(request, state)
    lifting, state = request.segment("lift", parameterise(line, request.reach.limits), state)
    return (lifting,), state


def carry(request: Request, state: State) -> Motion:
    agent, subgoal, (_, tcp_from_object) = request.agent, request.subgoal, _held(request, state)
    goals = ends(request.task, subgoal, state, tcp_from_object)
    points = request.reach.timed(agent, goals, 0.0, state, frozenset(), subgoal.text, rise=True)
    carrying, state = request.segment("carry", points, state)
    return (carrying,), state


def place(request: Request, state: State) -> Motion:
    agent, subgoal, (name, tcp_from_object) = request.agent, request.subgoal, _held(request, state)
    goals = ends(request.task, subgoal, state, tcp_from_object)
    touches = frozenset({name}) | support(request.task, subgoal)
    after = once_placed(request, state)
    points = request.reach.timed(
        agent, goals, CLEARANCE_M, state, touches, subgoal.text, down=True, rise=True, look_ahead=after
    )
    lowering, state = request.segment("lower", points, state, touches)
    letting_go, state = _let_go(request, state, touches)
    rests = fallen(request.task, subgoal, state.poses[name], state.poses)
    state = replace(state, poses={**state.poses, name: rests})
    return (lowering, *letting_go), state


def strike(request: Request, state: State) -> Motion:
    agent, subgoal, (name, tcp_from_object) = request.agent, request.subgoal, _held(request, state)
    goals = ends(request.task, subgoal, state, tcp_from_object)
    touches = frozenset({name, _required(subgoal.target)})
    points = request.reach.timed(agent, goals, CLEARANCE_M, state, touches, subgoal.text, down=True)
    striking, state = request.segment("strike", points, state, touches)
    return (striking,), state


def release(request: Request, state: State) -> Motion:
    _held(request, state)
    return _let_go(request, state, state.in_hand(request.agent))


def press(request: Request, state: State) -> Motion:
    point, tiers = _met(request, state)
    touches = frozenset({_required(request.subgoal.object)})
    if _presses(request.tcp(state), tiers):
        return _press_on(request, state, touches)
    close, state = _fingers(request, "close", GRIPPER_CLOSED, state)
    agent, what = request.agent, request.subgoal.text
    points = request.reach.timed(agent, tiers, point.standoff_m, state, touches, what)
    pressing, state = request.segment("press", points, state, touches)
    return (close, pressing), state


def _press_on(request: Request, state: State, touches: frozenset[str]) -> Motion:
    """Presses a little deeper: with an error in the measured joints, a finger may not have pressed."""
    agent = request.agent
    goal = drawn_back(request.tcp(state), -PRESS_ON_M)
    line = request.reach.line(agent, state.qpos[agent], goal)
    if line is None:
        raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(request.subgoal.text,))
    state = replace(state, gripper={**state.gripper, agent: GRIPPER_CLOSED})
    pressing, state = request.segment("press", parameterise(line, request.reach.limits), state, touches)
    return (pressing,), state


def shut(request: Request, state: State) -> Motion:
    """Closed fingers sweep a hinged object over from its back, until it falls shut by its own weight."""
    task, reach, agent, name = request.task, request.reach, request.agent, _required(request.subgoal.object)
    point, tiers = _met(request, state)
    hinge, begin = _required(task.asset(name).hinge), state.poses[name]
    touches = frozenset({name, _required(task.objects[name].relative_to)})
    open_rad, falls_rad = float(task.opened_rad(name, state.poses)), float(np.deg2rad(hinge.falls_deg))
    if open_rad <= falls_rad:
        return (), state  # nothing holds it open
    arc_rad = np.linspace(open_rad, falls_rad, int(np.ceil((open_rad - falls_rad) / ARC_RAD)) + 1)[1:]
    turns = task.hung(name, state.poses, arc_rad) @ inverse(begin)  # (K, 4, 4) of the object, in the world

    def arc(contact: Matrix) -> Floats:
        """(K, 4, 4) TCP poses; the gripper does not turn with the object, as a distant arm could not."""
        poses = np.tile(contact, (len(turns), 1, 1))
        poses[:, :3, 3] = (turns @ contact)[:, :3, 3]
        return poses

    def after(goals: Floats) -> Callable[[int, Points], float]:
        def takes_s(goal: int, points: Points) -> float:
            swept = reach.along(agent, points[-1], arc(goals[goal]))
            return np.inf if swept is None else float(reach.duration_s(swept[[0, -1]]))

        return takes_s

    close, state = _fingers(request, "close", GRIPPER_CLOSED, state)
    what, ahead = request.subgoal.text, LookAhead(after)
    points = reach.timed(agent, tiers, point.standoff_m, state, touches, what, look_ahead=ahead)
    approach, state = request.segment("approach", points, state, touches)
    contact = request.tcp(state)
    line = reach.along(agent, state.qpos[agent], arc(contact))
    if line is None:
        raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(what,))
    timed = parameterise(line, reach.limits)
    from_axis = inverse(task.hung(name, state.poses, 0.0) @ hinge.object_from_hinge)
    x_m, _, z_m, _ = (from_axis @ np.concatenate([contact[None], reach.arms[agent].tcp(timed)]))[..., 3].T
    about_rad = np.arctan2(x_m, z_m)
    falling_rad = np.linspace(falls_rad, 0.0, int(np.ceil(hinge.falls_s * CONTROL_HZ)) + 1)[1:]
    stays = np.tile(timed[-1], (len(falling_rad), 1))
    sweep, state = request.segment("shut", np.concatenate([timed, stays]), state, touches)
    opened_rad = np.concatenate([open_rad + about_rad[1:] - about_rad[0], falling_rad])
    state = replace(state, poses={**state.poses, name: task.hung(name, state.poses, 0.0)})
    retreat, state = _draw_back(request, state, touches)
    return (close, approach, replace(sweep, attached=name, opened_rad=opened_rad), retreat), state


def leave(request: Request, state: State) -> Motion:
    """Moves to rest, or to the retracted posture, on a free path."""
    posture = "aside" if request.subgoal.verb == "aside" else "home"
    goal = posture_rad(posture, request.task, request.agent)
    points = request.reach.freely(request.agent, goal, state, f"go {posture}")
    leaving, state = request.segment("move", points, state)
    return (leaving,), state


_NAMED = (grasp, lift, carry, place, strike, release, press, shut)  # named like their verbs
_PRIMITIVES: dict[str, Primitive] = {primitive.__name__: primitive for primitive in _NAMED}
_PRIMITIVES |= {"home": leave, "aside": leave, "hold": lambda _, state: ((), state)}


def add_primitive(verb: str, primitive: Primitive) -> None:
    """Registers the motion primitive of a verb that was added with `rf_exp.statements.add_verb`.

    A primitive finds timed points with `request.reach`, makes segments of them with `request.segment`, and
    raises Unreachable where it cannot. Raises ArgumentError for a verb that is unknown or has a primitive.
    """
    if verb not in VERBS:
        raise choices("verb", verb, VERBS)
    if verb in _PRIMITIVES:
        raise ArgumentError(f"verb {verb!r} has a motion primitive already")
    _PRIMITIVES[verb] = primitive


def estimated_s(request: Request, state: State) -> float:
    """Estimated duration of grasping or pressing an object, and of what the agent does with it next.

    Infinite where the agent cannot reach either, or holds another object.
    """
    name = _required(request.subgoal.object)
    if state.in_hand(request.agent) - {name}:
        return np.inf
    arm = request.reach.arms[request.agent]
    if np.linalg.norm(state.poses[name][:2, 3] - arm.world_from_base[:2, 3]) > arm.robot.reach_m + FAR_M:
        return np.inf  # cheaper than kinematics
    point, tiers = _met(request, state)
    look_ahead = once_grasped(request, name, state)
    return request.reach.estimated_s(request.agent, tiers, point.standoff_m, state, look_ahead)


def _presses(tcp: Matrix, tiers: Tiers) -> bool:
    """Whether the TCP is at a pose in which it presses, or beyond."""
    for goal in np.concatenate([np.stack(tier) for tier in tiers]):
        tcp_from_goal = inverse(goal) @ tcp
        beside_m, on_m = np.linalg.norm(tcp_from_goal[:2, 3]), tcp_from_goal[2, 3]
        turned = np.abs(tcp_from_goal[:3, :3] - np.eye(3)).max()
        if beside_m < STANDS_M and on_m > -STANDS_M and turned < STANDS_M / FINGER_M:
            return True
    return False


def _met(request: Request, state: State) -> tuple[InteractionPoint, Tiers]:
    """The interaction point of the object of a subgoal, and the TCP poses at contact."""
    name = _required(request.subgoal.object)
    point = request.task.asset(name).points[_required(request.subgoal.point)]
    goals = contacts(state.poses[name], point)
    return point, [[goal @ tip for goal in goals] for tip in _tips(point.tip_deg)]


def lift_line(request: Request, state: State) -> Points:
    """Joint points (K, dof) of a lift straight up; K depends on the height alone."""
    _held(request, state)
    agent, subgoal = request.agent, request.subgoal
    goal = above(request.tcp(state), _required(subgoal.height_m))
    line = request.reach.line(agent, state.qpos[agent], goal)
    if line is None:
        raise Unreachable(Cause.REACH, Finding.TOO_HIGH, (agent,), subgoals=(subgoal.text,))
    # At the start the lifted object touches the object that supports it.
    name = _required(subgoal.object)
    supports = request.task.objects[name].relative_to
    touches = frozenset({name, supports} if supports else {name})
    if obstacle := request.reach.blocked(agent, line, state, touches):
        raise obstructed(subgoal.text, Blockage(agent, line, state, touches, obstacle))
    return line


def _let_go(request: Request, state: State, touches: frozenset[str]) -> Motion:
    agent = request.agent
    # Once the gripper opens, the object is no longer held, only touched.
    state = replace(state, held={each: what for each, what in state.held.items() if each != agent})
    opened, state = _fingers(request, "open", GRIPPER_OPEN, state, touches)
    retreat, state = _draw_back(request, state, touches)
    return (opened, retreat), state


def _draw_back(request: Request, state: State, touches: frozenset[str]) -> tuple[Segment, State]:
    agent = request.agent
    line = request.reach.line(agent, state.qpos[agent], drawn_back(request.tcp(state), RETREAT_M))
    if line is None:
        raise Unreachable(Cause.REACH, Finding.NO_RETREAT, (agent,), object=request.subgoal.object)
    return request.segment("retreat", parameterise(line, request.reach.limits), state, touches)


def _held(request: Request, state: State) -> tuple[str, Matrix]:
    subgoal, held = request.subgoal, state.held.get(request.agent)
    if held is None or held[0] != subgoal.object:
        missing = {"subgoals": (subgoal.text,), "object": subgoal.object}
        raise Unreachable(Cause.GRIP, Finding.HOLDS_NOT, (subgoal.agent,), **missing)
    return held


def _fingers(
    request: Request, primitive: str, command: float, state: State, touches: frozenset[str] = frozenset()
) -> tuple[Segment, State]:
    still = np.tile(state.qpos[request.agent], (GRIPPER_STEPS, 1))
    state = replace(state, gripper={**state.gripper, request.agent: command})
    return request.segment(primitive, still, state, touches)


def _required(value: T | None) -> T:
    assert value is not None  # ensured by `read_subgoal`
    return value


@cache
def _tips(most_deg: float) -> tuple[Matrix, ...]:
    """Rotations about the y axis of a TCP by which a grasp may be tipped, the smallest first."""
    angles = (tip for tip in _TIPS_DEG if abs(tip) <= most_deg)
    return tuple(transform(rotation=Rotation.from_euler("y", angle, degrees=True)) for angle in angles)
