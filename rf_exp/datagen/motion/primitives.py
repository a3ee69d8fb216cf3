"""Motion primitives: each subgoal becomes rest-to-rest segments of one agent (paper, supplementary A).

A subgoal is carried out from the state in which the previous one leaves the agent, so a whole
proposal is planned ahead of its execution. `State` is that predicted state.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.datagen.motion.path import find_path
from rf_exp.datagen.motion.timing import JointLimits, blend, densify, parameterise
from rf_exp.robots import Panda
from rf_exp.tasks import Task
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.tasks.base import REST_QPOS
from rf_exp.transforms import Matrix, interpolate, inverse, transform
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Segment, Subgoal

GRIPPER_STEPS = 8  # control steps that closing or opening takes, 0.4 s
LINE_STEP_M = 0.01  # between inverse kinematics solutions on a straight line
BLEND_RAD = (0.15, 0.06, 0.02)  # corners are rounded over this; less where that runs into something
PLACE_CLEARANCE_M = 0.10  # above the place from which an object is lowered
RETREAT_M = 0.08
STRIKE_M = 0.002  # a tool is driven so far into what it strikes; the arm gives way
DROP_M = 0.004  # let go this far above the place, so that nothing is pressed into the table
_RANDOM_SEEDS, _SPREAD_RAD = 12, 0.6  # inverse kinematics restarts when the natural ones fail
_SWIVELS = np.array([[turn, 0, -turn, 0, 0, 0, 0] for turn in (-0.7, 0.7)])  # rad, the elbow to a side
_SAME_RAD = 0.05  # solutions nearer than this are one
_MAX_JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch

_FACING = np.diag([1.0, -1.0, -1.0, 1.0])  # from a face, z up, to a tool that works on it, z down
_TIPS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
_STRIKE_TURNS = 16
_WITH_HELD = ("lift", "carry", "place", "strike")  # verbs that move what is held
_SPOT = InteractionPoint(np.eye(4), "place", turns=12)  # a named place: how a thing is turned there is free

T = TypeVar("T")
Tiers = Sequence[Sequence[Matrix]]  # TCP poses; those of one tier serve equally, a later one is a last resort
Onward = Callable[
    [int, NDArray[np.float64], Matrix], float | None
]  # (agent, joints, TCP pose) -> rad or None


class Unreachable(Exception):
    """No motion carries out a subgoal; the text says why."""


@dataclass
class State:
    """What planning believes so far: joints, grippers, what is held, where things are."""

    qpos: dict[int, NDArray[np.float64]]  # agent -> (7,) rad
    gripper: dict[int, float]
    held: dict[int, tuple[str, Matrix]]  # agent -> object, tcp_from_object
    poses: dict[str, Matrix]  # object -> world_from_object
    places: Mapping[str, Matrix] = field(default_factory=dict)
    targets: frozenset[str] = frozenset()  # objects that the present subgoal is about


class Blocked(Protocol):
    """Knows the obstacles: what is in the way of an agent at joint points (K, 7), or None.

    The gripper may touch `touches`. With `between`, the motion from each point to the next counts too.
    """

    def __call__(
        self,
        agent: int,
        points: NDArray[np.float64],
        state: State,
        touches: frozenset[str],
        *,
        between: bool = False,
    ) -> str | None: ...


@dataclass(frozen=True)
class Primitives:
    """Plans single subgoals of a task. `blocked` knows the obstacles that the row lets it see."""

    task: Task
    arms: Mapping[int, Panda]
    limits: JointLimits
    blocked: Blocked
    rng: np.random.Generator

    def plan(self, subgoal: Subgoal, state: State, following: Sequence[Subgoal] = ()) -> list[Segment]:
        """The segments of one subgoal; `state` moves on to what they leave. Raises Unreachable.

        `following`: what the agent does next. A grasp is chosen so that this can be reached.
        """
        state.targets = frozenset(set(self.task.objects) & {subgoal.object, subgoal.target})
        if subgoal.verb == "grasp":
            return self._grasp(subgoal, state, following)
        return getattr(self, f"_{subgoal.verb}")(subgoal, state)

    # -- the verbs -------------------------------------------------------------------------------

    def _grasp(self, subgoal: Subgoal, state: State, following: Sequence[Subgoal]) -> list[Segment]:
        agent, name = subgoal.agent, _required(subgoal.object)
        if agent in state.held:
            if state.held[agent][0] == name:
                return []
            raise Unreachable(f"Agent_{agent} already holds {state.held[agent][0]}")
        point = self.task.asset(name).points[_required(subgoal.point)]
        touches = frozenset({name})
        goals = _turned(state.poses[name] @ point.object_from_tcp, point.turns)
        tips = [transform(rotation=_pitch(np.deg2rad(tip))) for tip in _TIPS_DEG if abs(tip) <= point.tip_deg]
        reach = self._reach(
            agent,
            [[goal @ tip for goal in goals] for tip in tips],
            point.standoff_m,
            state,
            touches,
            f"grasp {name} at {subgoal.point}",
            onward=self._onward(following, name, state),
        )
        segments = [self._segment(subgoal, "approach", reach, state, touches)]
        segments.append(self._fingers(subgoal, "close", GRIPPER_CLOSED, state, touches))
        tcp_from_object = inverse(self.arms[agent].tcp(state.qpos[agent])) @ state.poses[name]
        state.held[agent] = (name, tcp_from_object)
        return segments

    def _lift(self, subgoal: Subgoal, state: State) -> list[Segment]:
        line = self.lift_line(subgoal, state)
        return [self._segment(subgoal, "lift", parameterise(line, self.limits), state)]

    def _carry(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (_, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        points = self._reach(agent, goals, 0.0, state, frozenset(), subgoal.text)
        return [self._segment(subgoal, "carry", points, state)]

    def _place(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (name, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        touches = frozenset({name}) | self._support(subgoal)
        points = self._reach(agent, goals, PLACE_CLEARANCE_M, state, touches, subgoal.text, down=True)
        segments = [self._segment(subgoal, "lower", points, state, touches)]
        return [*segments, *self._let_go(subgoal, state, touches)]

    def _strike(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (name, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        touches = frozenset({name, _required(subgoal.target)})
        points = self._reach(agent, goals, PLACE_CLEARANCE_M, state, touches, subgoal.text, down=True)
        return [self._segment(subgoal, "strike", points, state, touches)]

    def _release(self, subgoal: Subgoal, state: State) -> list[Segment]:
        name, _ = self._holding(subgoal, state)
        return self._let_go(subgoal, state, frozenset({name}))

    def _press(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, name = subgoal.agent, _required(subgoal.object)
        point = self.task.asset(name).points[_required(subgoal.point)]
        goals = _turned(state.poses[name] @ point.object_from_tcp, point.turns)
        touches = frozenset({name})
        segments = [self._fingers(subgoal, "close", GRIPPER_CLOSED, state)]
        points = self._reach(
            agent, [goals], point.standoff_m, state, touches, f"press {name} at {subgoal.point}"
        )
        return [*segments, self._segment(subgoal, "press", points, state, touches)]

    def _home(self, subgoal: Subgoal, state: State) -> list[Segment]:
        rest = np.array(self.task.robots[subgoal.agent - 1].rest_rad)
        path = self._free_path(subgoal.agent, rest, state, "go home")
        points = parameterise(blend(densify(path), BLEND_RAD[0]), self.limits)
        return [self._segment(subgoal, "move", points, state)]

    def _hold(self, subgoal: Subgoal, state: State) -> list[Segment]:
        return []

    # -- what the verbs are made of ----------------------------------------------------------------

    def _onward(self, subgoals: Sequence[Subgoal], name: str, state: State) -> Onward:
        """The cost of what an agent does next with an object, once it holds it as from some TCP pose."""
        with_it = [each for each in subgoals if each.object == name and each.verb in _WITH_HELD]

        def cost_rad(agent: int, joints: NDArray[np.float64], goal: Matrix) -> float | None:
            tcp_from_object, total = inverse(goal) @ state.poses[name], 0.0
            for each in with_it:
                line = None
                if each.verb == "lift":
                    raised = self.arms[agent].tcp(joints)
                    line = self._line(agent, joints, raised, _above(raised, _required(each.height_m)))
                elif (ends := self._ends_or_none(each, state, tcp_from_object)) is None:
                    return total  # that will be said when its turn comes
                else:
                    ways = (self._arrive(agent, end, joints) for tier in ends for end in tier)
                    line = min((way for way in ways if way is not None), key=_length_rad, default=None)
                if line is None:
                    return None
                total, joints = total + _length_rad(line), line[-1]
            return total

        return cost_rad

    def _arrive(self, agent: int, goal: Matrix, joints: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joints (3, 7) now, well above a TCP pose, and there; None where inverse kinematics fails."""
        arm, raised = self.arms[agent], _above(goal, PLACE_CLEARANCE_M)
        for seed in (joints, self._facing(agent, goal)):
            high = arm.solve(raised, seed)
            low = None if high is None else arm.solve(goal, high)
            if high is not None and low is not None:
                return np.stack([joints, high, low])
        return None

    def _ends_or_none(self, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> Tiers | None:
        try:
            return self._ends(subgoal, state, tcp_from_object)
        except Unreachable:
            return None

    def _ends(self, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> Tiers:
        """TCP poses in which an object held so has been carried, placed or struck as the subgoal says."""
        if subgoal.verb == "carry":
            return self._over(subgoal, state, tcp_from_object, subgoal.height_m or 0.0)
        if subgoal.verb == "place":
            return self._over(subgoal, state, tcp_from_object, DROP_M)
        tool = self.task.asset(_required(subgoal.object)).points[_required(subgoal.point)]
        world_from_target, _ = self._destination(subgoal, state)
        face = world_from_target @ transform((0.0, 0.0, -STRIKE_M))
        grip = _FACING @ inverse(tcp_from_object @ tool.object_from_tcp)
        return [[turned @ grip for turned in _turned(face, _STRIKE_TURNS)]]

    def _support(self, subgoal: Subgoal) -> frozenset[str]:
        """The object on which something is placed; none where it is dropped into one."""
        target = _required(subgoal.target)
        if target not in self.task.objects or self._placing(subgoal).kind == "drop":
            return frozenset()
        return frozenset({target})

    def lift_line(self, subgoal: Subgoal, state: State) -> NDArray[np.float64]:
        """Joint points (K, 7) of a lift straight up; K depends on the height alone."""
        self._holding(subgoal, state)
        start = self.arms[subgoal.agent].tcp(state.qpos[subgoal.agent])
        goal = start.copy()
        goal[2, 3] += _required(subgoal.height_m)
        line = self._line(subgoal.agent, state.qpos[subgoal.agent], start, goal)
        if line is None:
            raise Unreachable(
                f"Agent_{subgoal.agent} cannot {subgoal.text}: the arm does not reach that high"
            )
        if obstacle := self.blocked(subgoal.agent, line, state, self._touches_lifting(subgoal, state)):
            raise Unreachable(f"Agent_{subgoal.agent} cannot {subgoal.text}: {obstacle} is in the way")
        return line

    def commit(self, subgoal: Subgoal, primitive: str, points, state: State, joined: str | None) -> Segment:
        """A segment along timed points (T, 7), with `state` moved to its end."""
        return replace(self._segment(subgoal, primitive, points, state), joined=joined)

    def _touches_lifting(self, subgoal: Subgoal, state: State) -> frozenset[str]:
        # What is lifted leaves the thing it stands on, which it touches at the start.
        supports = self.task.objects[_required(subgoal.object)].relative_to
        return frozenset({_required(subgoal.object)} | ({supports} if supports else set()))

    def _let_go(self, subgoal: Subgoal, state: State, touches: frozenset[str]) -> list[Segment]:
        agent = subgoal.agent
        name, _ = state.held.pop(agent)  # from the first opening on nothing is held, only touched
        touches = touches | {name}
        opened = self._fingers(subgoal, "open", GRIPPER_OPEN, state, touches)
        start = self.arms[agent].tcp(state.qpos[agent])
        line = self._line(agent, state.qpos[agent], start, start @ transform((0.0, 0.0, -RETREAT_M)))
        if line is None:
            raise Unreachable(f"Agent_{agent} cannot draw back after letting go of {subgoal.object}")
        return [opened, self._segment(subgoal, "retreat", parameterise(line, self.limits), state, touches)]

    def _holding(self, subgoal: Subgoal, state: State) -> tuple[str, Matrix]:
        held = state.held.get(subgoal.agent)
        if held is None or held[0] != subgoal.object:
            raise Unreachable(
                f"Agent_{subgoal.agent} cannot {subgoal.text}: it does not hold {subgoal.object}"
            )
        return held

    def _destination(self, subgoal: Subgoal, state: State) -> tuple[Matrix, InteractionPoint]:
        """world_from_object of the thing once it has been placed, and the point that says how freely."""
        target = _required(subgoal.target)
        if target in state.places:
            return state.places[target], _SPOT
        if target not in state.poses:
            known = ", ".join(sorted([*state.places, *state.poses]))
            raise Unreachable(f"there is no place or object {target!r}; available: {known}")
        point = self._placing(subgoal)
        return state.poses[target] @ point.object_from_tcp, point

    def _placing(self, subgoal: Subgoal) -> InteractionPoint:
        """The point of the target object at which something is placed or dropped."""
        points = self.task.asset(_required(subgoal.target)).points
        placing = {name: point for name, point in points.items() if point.kind in ("place", "drop")}
        name = subgoal.target_point or next(iter(placing), None)
        if name not in placing:
            listed = ", ".join(sorted(placing)) or "none"
            raise Unreachable(f"{subgoal.target} has no place point {name!r}; available: {listed}")
        return placing[name]

    def _over(self, subgoal: Subgoal, state: State, tcp_from_object: Matrix, height_m: float) -> Tiers:
        """TCP poses that put the held object at its destination, raised by `height_m`; best tier first.

        It may be turned as the place allows, and where nothing else is reachable stand off towards the
        arm by the slack of the place.
        """
        world_from_object, point = self._destination(subgoal, state)
        towards_arm = self.arms[subgoal.agent].world_from_base[:2, 3] - world_from_object[:2, 3]
        towards_arm /= np.linalg.norm(towards_arm)
        tiers = []
        for offset_m in (0.0, point.slack_m / 2, point.slack_m) if point.slack_m else (0.0,):
            raised = _above(world_from_object, height_m)
            raised[:2, 3] += offset_m * towards_arm
            tiers.append([turned @ inverse(tcp_from_object) for turned in _turned(raised, point.turns)])
        return tiers

    def _reach(
        self,
        agent: int,
        tiers: Tiers,
        standoff_m: float,
        state: State,
        touches: frozenset[str],
        what: str,
        *,
        down: bool = False,
        onward: Onward | None = None,
    ) -> NDArray[np.float64]:
        """Timed points (T, 7) to the first goal that can be reached, ending with a straight approach.

        The approach comes along the tool's z axis from `standoff_m` away, or straight down.
        Free motion and approach are one motion with a rounded corner.
        """
        reasons = []
        for pre, line in self._ways(agent, tiers, standoff_m, state, down, onward):
            path = self._free_path_or_none(agent, pre, state)
            if path is None:
                reasons.append("no free path")
                continue
            corners = densify(np.concatenate([path, line]))
            for radius_rad in BLEND_RAD:
                points = blend(corners, radius_rad)
                obstacle = self.blocked(agent, points, state, touches, between=True)
                if obstacle is None:
                    return parameterise(points, self.limits)
            reasons.append(f"{obstacle} is in the way")
        reason = f": {', '.join(dict.fromkeys(reasons))}" if reasons else ": out of reach"
        raise Unreachable(f"Agent_{agent} cannot {what}{reason}")

    def _ways(
        self, agent: int, tiers: Tiers, standoff_m: float, state: State, down: bool, onward: Onward | None
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """(joints before the approach, joint points of the approach), tier by tier the shortest first.

        Those from which what comes next cannot be reached come last of all.
        """
        last = []
        for tier in tiers:
            found = []
            for goal in tier:
                pre = _above(goal, standoff_m) if down else goal @ transform((0.0, 0.0, -standoff_m))
                for joints, line in self._lines(agent, pre, goal, state.qpos[agent], bool(found)):
                    cost = np.abs(joints - state.qpos[agent]).max() + _length_rad(line)
                    more = onward(agent, line[-1], goal) if onward else 0.0
                    way = (round(float(cost + (more or 0.0)), 6), len(found), joints, line)
                    (last if more is None else found).append(way)
            for _, _, joints, line in sorted(found, key=lambda way: way[:2]):
                yield joints, line
        for _, _, joints, line in last:
            yield joints, line

    def _lines(
        self, agent: int, pre: Matrix, goal: Matrix, current: NDArray[np.float64], found: bool
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Distinct (joints at `pre`, joint points from there to `goal`) of one goal.

        The arm has a joint to spare, so one pose has many postures; some lead through stretched arms,
        where a short line takes long.
        """
        known: list[NDArray[np.float64]] = []
        facing = self._facing(agent, goal)
        spare = [facing + self.rng.normal(0.0, _SPREAD_RAD, 7) for _ in range(_RANDOM_SEEDS)]
        for tried, seed in enumerate([current, facing, *(facing + swivel for swivel in _SWIVELS), *spare]):
            if (known or found) and tried >= 2 + len(_SWIVELS):
                break
            joints = self.arms[agent].solve(pre, seed)
            if joints is None or any(np.abs(joints - other).max() < _SAME_RAD for other in known):
                continue
            line = self._line(agent, joints, pre, goal)
            if line is not None:
                known.append(joints)
                yield joints, line

    def _facing(self, agent: int, goal: Matrix) -> NDArray[np.float64]:
        """Joints (7,) of an arm at rest, turned towards a TCP pose: a good first guess."""
        in_base = inverse(self.arms[agent].world_from_base) @ goal
        return np.array([np.arctan2(in_base[1, 3], in_base[0, 3]), *REST_QPOS[1:]])

    def _line(
        self, agent: int, joints: NDArray[np.float64], start: Matrix, goal: Matrix
    ) -> NDArray[np.float64] | None:
        """Joint points (K, 7) of the straight TCP line from `start` (where `joints` is) to `goal`."""
        count = max(1, int(np.ceil(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / LINE_STEP_M - 1e-6)))
        points = [joints]
        for fraction in np.arange(1, count + 1) / count:
            solution = self.arms[agent].solve(interpolate(start, goal, fraction), points[-1])
            if solution is None or np.abs(solution - points[-1]).max() > _MAX_JUMP_RAD:
                return None
            points.append(solution)
        return np.array(points)

    def _free_path_or_none(
        self, agent: int, goal: NDArray[np.float64], state: State
    ) -> NDArray[np.float64] | None:
        held = frozenset({state.held[agent][0]}) if agent in state.held else frozenset()

        def free(points: NDArray[np.float64]) -> bool:
            return self.blocked(agent, points, state, held) is None

        return find_path(state.qpos[agent], goal, free, self.rng)

    def _free_path(
        self, agent: int, goal: NDArray[np.float64], state: State, what: str
    ) -> NDArray[np.float64]:
        path = self._free_path_or_none(agent, goal, state)
        if path is None:
            raise Unreachable(f"Agent_{agent} cannot {what}: no free path")
        return path

    def _segment(
        self,
        subgoal: Subgoal,
        primitive: str,
        points: NDArray[np.float64],
        state: State,
        touches: frozenset[str] = frozenset(),
    ) -> Segment:
        agent = subgoal.agent
        name, tcp_from_object = state.held.get(agent, (None, None))
        gripper = np.full(len(points), state.gripper[agent])
        if len(points):
            state.qpos[agent] = points[-1]
        if name is not None and tcp_from_object is not None:
            state.poses[name] = self.arms[agent].tcp(state.qpos[agent]) @ tcp_from_object
            touches = touches | {name}
        return Segment(agent, subgoal, primitive, points, gripper, name, tcp_from_object, touches)

    def _fingers(
        self,
        subgoal: Subgoal,
        primitive: str,
        command: float,
        state: State,
        touches: frozenset[str] = frozenset(),
    ) -> Segment:
        state.gripper[subgoal.agent] = command
        return self._segment(
            subgoal, primitive, np.tile(state.qpos[subgoal.agent], (GRIPPER_STEPS, 1)), state, touches
        )


def _required(value: T | None) -> T:
    assert value is not None  # parse_subgoal has seen to it
    return value


def _above(pose: Matrix, height_m: float) -> Matrix:
    raised = pose.copy()
    raised[2, 3] += height_m
    return raised


def _length_rad(points: NDArray[np.float64]) -> float:
    """Length of a joint path (K, 7): what it costs in time, but for starting and stopping."""
    return float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())


def _turned(goal: Matrix, turns: int) -> list[Matrix]:
    """The pose and those that equal turns about its z axis give."""
    angles = np.linspace(0.0, 2 * np.pi, turns, endpoint=False)
    return [goal @ transform(rotation=_yaw(angle)) for angle in angles]


def _yaw(angle_rad: float) -> Rotation:
    return Rotation.from_euler("z", angle_rad)


def _pitch(angle_rad: float) -> Rotation:
    return Rotation.from_euler("y", angle_rad)
