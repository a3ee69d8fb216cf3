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

from rf_exp.datagen.motion.reach import PREPLACE_HEIGHT_M, LookAhead, Tiers, above, contact_poses, drawn_back
from rf_exp.datagen.motion.request import Request, after_grasp, after_placement, end_poses, support
from rf_exp.datagen.motion.state import Blockage, Floats, Points, State, Unreachable, obstruction_error
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.yielding import posture_rad
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.findings import Cause, Finding
from rf_exp.geometry import pose_after_drop
from rf_exp.statements import VERBS
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import CONTROL_HZ, GRIPPER_CLOSED, GRIPPER_OPEN, Segment

GRIPPER_STEPS = 8  # control steps that closing or opening takes, 0.4 s
RETREAT_M = 0.08
MAX_POINT_DISTANCE_M = 0.3  # bound on the distance from the origin of an object to its interaction points
EXTRA_PRESS_M = 0.004  # deeper, where pressing was not enough
POSE_TOLERANCE_M = 0.003  # tolerance for a gripper to be at a pose
ROTATION_LEVER_M = 0.05  # lever that converts this tolerance into one of rotation
SWEEP_STEP_RAD = 0.05  # between postures of a sweep, at most
_TILTS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)

T = TypeVar("T")
Motion = tuple[tuple[Segment, ...], State]
Primitive = Callable[[Request, State], Motion]


def plan(request: Request, state: State) -> Motion:
    """The segments of one subgoal, and the state they leave. Raises Unreachable."""
    targets = frozenset({*request.task.objects} & {request.subgoal.object, request.subgoal.target})
    verb = request.subgoal.verb
    if verb not in _PRIMITIVES:
        message = f"verb {verb!r} has no motion primitive"
        raise ArgumentError(f"{message}; rf_exp.datagen.add_primitive gives it one")
    return _PRIMITIVES[verb](request, replace(state, targets=targets))


def grasp(request: Request, state: State) -> Motion:
    agent, name = request.agent, _required(request.subgoal.object)
    if agent in state.held:
        if state.held[agent][0] == name:
            return (), state
        raise Unreachable(Cause.GRIP, Finding.HOLDS_OTHER, (agent,), object=state.held[agent][0])
    point, tiers = _contact_goals(request, state)
    touches = frozenset({name})
    text, look_ahead, detour = request.subgoal.text, after_grasp(request, name, state), point.around > 1
    points = request.reach.timed(
        agent, tiers, point.standoff_m, state, touches, text, avoid_touched=detour, look_ahead=look_ahead
    )
    approach, state = request.segment("approach", points, state, touches)
    close, state = _move_gripper(request, "close", GRIPPER_CLOSED, state, touches)
    tcp_from_object = inverse(request.tcp(state)) @ state.poses[name]
    return (approach, close), replace(state, held={**state.held, agent: (name, tcp_from_object)})


def lift(request: Request, state: State) -> Motion:
    line = lift_line(request, state)
    lifting, state = request.segment("lift", parameterise(line, request.reach.limits), state)
    return (lifting,), state


def carry(request: Request, state: State) -> Motion:
    agent, subgoal, (_, tcp_from_object) = request.agent, request.subgoal, _held_object(request, state)
    goals = end_poses(request.task, subgoal, state, tcp_from_object)
    points = request.reach.timed(agent, goals, 0.0, state, frozenset(), subgoal.text, rise=True)
    carrying, state = request.segment("carry", points, state)
    return (carrying,), state


def place(request: Request, state: State) -> Motion:
    agent, subgoal, (name, tcp_from_object) = request.agent, request.subgoal, _held_object(request, state)
    goals = end_poses(request.task, subgoal, state, tcp_from_object)
    touches = frozenset({name}) | support(request.task, subgoal)
    text, after = subgoal.text, after_placement(request, state)
    points = request.reach.timed(
        agent, goals, PREPLACE_HEIGHT_M, state, touches, text, from_above=True, rise=True, look_ahead=after
    )
    lowering, state = request.segment("lower", points, state, touches)
    release_motion, state = _release_and_retreat(request, state, touches)
    rest = pose_after_drop(request.task, subgoal, state.poses[name], state.poses)
    state = replace(state, poses={**state.poses, name: rest})
    return (lowering, *release_motion), state


def strike(request: Request, state: State) -> Motion:
    agent, subgoal, (name, tcp_from_object) = request.agent, request.subgoal, _held_object(request, state)
    goals = end_poses(request.task, subgoal, state, tcp_from_object)
    touches = frozenset({name, _required(subgoal.target)})
    points = request.reach.timed(
        agent, goals, PREPLACE_HEIGHT_M, state, touches, subgoal.text, from_above=True
    )
    striking, state = request.segment("strike", points, state, touches)
    return (striking,), state


def release(request: Request, state: State) -> Motion:
    _held_object(request, state)
    return _release_and_retreat(request, state, state.in_hand(request.agent))


def press(request: Request, state: State) -> Motion:
    point, tiers = _contact_goals(request, state)
    touches = frozenset({_required(request.subgoal.object)})
    if _is_pressing(request.tcp(state), tiers):
        return _press_deeper(request, state, touches)
    close, state = _move_gripper(request, "close", GRIPPER_CLOSED, state)
    agent, subgoal_text = request.agent, request.subgoal.text
    points = request.reach.timed(agent, tiers, point.standoff_m, state, touches, subgoal_text)
    pressing, state = request.segment("press", points, state, touches)
    return (close, pressing), state


def _press_deeper(request: Request, state: State, touches: frozenset[str]) -> Motion:
    """Presses a little deeper: with an error in the measured joints, a finger may not have pressed."""
    agent = request.agent
    goal = drawn_back(request.tcp(state), -EXTRA_PRESS_M)
    line = request.reach.line(agent, state.qpos[agent], goal)
    if line is None:
        raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(request.subgoal.text,))
    state = replace(state, gripper={**state.gripper, agent: GRIPPER_CLOSED})
    pressing, state = request.segment("press", parameterise(line, request.reach.limits), state, touches)
    return (pressing,), state


def shut(request: Request, state: State) -> Motion:
    """Closed fingers sweep a hinged object over from its back, until it falls shut by its own weight."""
    task, reach, agent, name = request.task, request.reach, request.agent, _required(request.subgoal.object)
    point, tiers = _contact_goals(request, state)
    hinge, begin = _required(task.asset(name).hinge), state.poses[name]
    touches = frozenset({name, _required(task.objects[name].relative_to)})
    open_rad, fall_rad = float(task.hinge_rad(name, state.poses)), float(np.deg2rad(hinge.falls_deg))
    if open_rad <= fall_rad:
        return (), state  # nothing holds it open
    arc_rad = np.linspace(open_rad, fall_rad, int(np.ceil((open_rad - fall_rad) / SWEEP_STEP_RAD)) + 1)[1:]
    poses = task.hinged_poses(name, state.poses, arc_rad)
    turns = poses @ inverse(begin)  # (K, 4, 4) of the object, in the world

    def arc_poses(contact: Matrix) -> Floats:
        """(K, 4, 4) TCP poses; the gripper does not turn with the object, as a distant arm could not."""
        poses = np.tile(contact, (len(turns), 1, 1))
        poses[:, :3, 3] = (turns @ contact)[:, :3, 3]
        return poses

    def cost_to_go(goals: Floats) -> Callable[[int, Points], float]:
        def sweep_s(goal: int, points: Points) -> float:
            line = reach.path_through(agent, points[-1], arc_poses(goals[goal]))
            return np.inf if line is None else float(reach.duration_s(line[[0, -1]]))

        return sweep_s

    close, state = _move_gripper(request, "close", GRIPPER_CLOSED, state)
    subgoal_text, look_ahead = request.subgoal.text, LookAhead(cost_to_go)
    points = reach.timed(agent, tiers, point.standoff_m, state, touches, subgoal_text, look_ahead=look_ahead)
    approach, state = request.segment("approach", points, state, touches)
    contact = request.tcp(state)
    line = reach.path_through(agent, state.qpos[agent], arc_poses(contact))
    if line is None:
        raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(subgoal_text,))
    timed = parameterise(line, reach.limits)
    from_axis = inverse(task.hinged_poses(name, state.poses, 0.0) @ hinge.object_from_hinge)
    x_m, _, z_m, _ = (from_axis @ np.concatenate([contact[None], reach.arms[agent].tcp(timed)]))[..., 3].T
    about_rad = np.arctan2(x_m, z_m)
    falling_rad = np.linspace(fall_rad, 0.0, int(np.ceil(hinge.falls_s * CONTROL_HZ)) + 1)[1:]
    waiting = np.tile(timed[-1], (len(falling_rad), 1))
    sweep, state = request.segment("shut", np.concatenate([timed, waiting]), state, touches)
    hinge_rad = np.concatenate([open_rad + about_rad[1:] - about_rad[0], falling_rad])
    state = replace(state, poses={**state.poses, name: task.hinged_poses(name, state.poses, 0.0)})
    retreat, state = _retreat(request, state, touches)
    return (close, approach, replace(sweep, attached=name, hinge_rad=hinge_rad), retreat), state


def leave(request: Request, state: State) -> Motion:
    """Moves to rest, or to the retracted posture, on a free path."""
    posture = "aside" if request.subgoal.verb == "aside" else "home"
    goal = posture_rad(posture, request.task, request.agent)
    points = request.reach.free_motion(request.agent, goal, state, f"go {posture}")
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
        raise unknown_choice("verb", verb, VERBS)
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
    distance_m = np.linalg.norm(state.poses[name][:2, 3] - arm.world_from_base[:2, 3])
    if distance_m > arm.robot.reach_m + MAX_POINT_DISTANCE_M:
        return np.inf  # cheaper than kinematics
    point, tiers = _contact_goals(request, state)
    look_ahead = after_grasp(request, name, state)
    return request.reach.estimated_s(request.agent, tiers, point.standoff_m, state, look_ahead)


def _is_pressing(tcp: Matrix, tiers: Tiers) -> bool:
    """Whether the TCP is at a pose in which it presses, or beyond."""
    for goal in np.concatenate([np.stack(tier) for tier in tiers]):
        tcp_from_goal = inverse(goal) @ tcp
        lateral_m, depth_m = np.linalg.norm(tcp_from_goal[:2, 3]), tcp_from_goal[2, 3]
        rotation_error = np.abs(tcp_from_goal[:3, :3] - np.eye(3)).max()
        close = lateral_m < POSE_TOLERANCE_M and depth_m > -POSE_TOLERANCE_M
        if close and rotation_error < POSE_TOLERANCE_M / ROTATION_LEVER_M:
            return True
    return False


def _contact_goals(request: Request, state: State) -> tuple[InteractionPoint, Tiers]:
    """The interaction point of the object of a subgoal, and the TCP poses at contact."""
    name = _required(request.subgoal.object)
    point = request.task.asset(name).points[_required(request.subgoal.point)]
    goals = contact_poses(state.poses[name], point)
    return point, [[goal @ tilt for goal in goals] for tilt in _tilts(point.tip_deg)]


def lift_line(request: Request, state: State) -> Points:
    """Joint points (K, dof) of a lift straight up; K depends on the height alone."""
    _held_object(request, state)
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
        raise obstruction_error(subgoal.text, Blockage(agent, line, state, touches, obstacle))
    return line


def _release_and_retreat(request: Request, state: State, touches: frozenset[str]) -> Motion:
    agent = request.agent
    # Once the gripper opens, the object is no longer held, only touched.
    state = replace(state, held={each: held for each, held in state.held.items() if each != agent})
    opened, state = _move_gripper(request, "open", GRIPPER_OPEN, state, touches)
    retreat, state = _retreat(request, state, touches)
    return (opened, retreat), state


def _retreat(request: Request, state: State, touches: frozenset[str]) -> tuple[Segment, State]:
    agent = request.agent
    line = request.reach.line(agent, state.qpos[agent], drawn_back(request.tcp(state), RETREAT_M))
    if line is None:
        raise Unreachable(Cause.REACH, Finding.NO_RETREAT, (agent,), object=request.subgoal.object)
    return request.segment("retreat", parameterise(line, request.reach.limits), state, touches)


def _held_object(request: Request, state: State) -> tuple[str, Matrix]:
    subgoal, held = request.subgoal, state.held.get(request.agent)
    if held is None or held[0] != subgoal.object:
        facts = {"subgoals": (subgoal.text,), "object": subgoal.object}
        raise Unreachable(Cause.GRIP, Finding.HOLDS_NOT, (subgoal.agent,), **facts)
    return held


def _move_gripper(
    request: Request, primitive: str, command: float, state: State, touches: frozenset[str] = frozenset()
) -> tuple[Segment, State]:
    waiting = np.tile(state.qpos[request.agent], (GRIPPER_STEPS, 1))
    state = replace(state, gripper={**state.gripper, request.agent: command})
    return request.segment(primitive, waiting, state, touches)


def _required(value: T | None) -> T:
    assert value is not None  # ensured by `read_subgoal`
    return value


@cache
def _tilts(max_deg: float) -> tuple[Matrix, ...]:
    """Rotations about the y axis of a TCP by which a grasp may be tipped, the smallest first."""
    angles = (angle for angle in _TILTS_DEG if abs(angle) <= max_deg)
    return tuple(transform(rotation=Rotation.from_euler("y", angle, degrees=True)) for angle in angles)
