"""Motion primitives: each subgoal becomes rest-to-rest segments of one agent (paper, supplementary A).

A subgoal is carried out from the state in which the previous one leaves the agent, so a whole
proposal is planned ahead of its execution. `State` is that predicted state.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
_RANDOM_SEEDS = 12  # inverse kinematics restarts when the natural ones fail
_MAX_JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch

_FACING = np.diag([1.0, -1.0, -1.0, 1.0])  # from a face, z up, to a tool that works on it, z down
_TIPS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
_STRIKE_TURNS = 16

T = TypeVar("T")


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
        reach = self._grip(subgoal, state, point, following)
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
            agent, goals, point.standoff_m, state, touches, f"press {name} at {subgoal.point}"
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

    def _grip(
        self, subgoal: Subgoal, state: State, point: InteractionPoint, following: Sequence[Subgoal]
    ) -> NDArray[np.float64]:
        """Timed points (T, 7) to an interaction point, tipped no farther than what follows takes."""
        name, what = _required(subgoal.object), f"grasp {subgoal.object} at {subgoal.point}"
        goals = _turned(state.poses[name] @ point.object_from_tcp, point.turns)
        tips = [tip for tip in _TIPS_DEG if abs(tip) <= point.tip_deg]
        tiers = [[goal @ transform(rotation=_pitch(np.deg2rad(tip))) for goal in goals] for tip in tips]
        useful = [[goal for goal in tier if self._leads_on(goal, name, following, state)] for tier in tiers]
        reason: Unreachable | None = None
        for tier in (*filter(None, useful), goals):
            try:
                return self._reach(subgoal.agent, tier, point.standoff_m, state, frozenset({name}), what)
            except Unreachable as error:
                reason = reason or error
        raise reason or AssertionError("there is always a last tier")

    def _leads_on(self, goal: Matrix, name: str, following: Sequence[Subgoal], state: State) -> bool:
        """Whether an arm that holds the object as from TCP pose `goal` can also do what comes next with it."""
        tcp_from_object = inverse(goal) @ state.poses[name]
        for each in following:
            if each.object == name and each.verb in ("carry", "place", "strike"):
                try:
                    ends = self._ends(each, state, tcp_from_object)
                except Unreachable:  # that will be said when its turn comes
                    return True
                return any(self._solves(each.agent, end) for end in ends)
        return True

    def _solves(self, agent: int, goal: Matrix) -> bool:
        """Whether inverse kinematics reaches a TCP pose, and one well above it."""
        arm, raised = self.arms[agent], goal.copy()
        raised[2, 3] += PLACE_CLEARANCE_M
        joints = arm.solve(raised, self._facing(agent, goal))
        return joints is not None and arm.solve(goal, joints) is not None

    def _ends(self, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> list[Matrix]:
        """TCP poses in which an object held so has been carried, placed or struck as the subgoal says."""
        if subgoal.verb == "carry":
            return self._above(subgoal, state, tcp_from_object, subgoal.height_m or 0.0)
        if subgoal.verb == "place":
            return self._above(subgoal, state, tcp_from_object, DROP_M)
        tool = self.task.asset(_required(subgoal.object)).points[_required(subgoal.point)]
        world_from_target, _ = self._destination(subgoal, state)
        return [
            world_from_target
            @ transform((0.0, 0.0, -STRIKE_M), _yaw(turn))
            @ _FACING
            @ inverse(tcp_from_object @ tool.object_from_tcp)
            for turn in np.linspace(0.0, 2 * np.pi, _STRIKE_TURNS, endpoint=False)
        ]

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

    def _destination(self, subgoal: Subgoal, state: State) -> tuple[Matrix, float]:
        """world_from_object of the thing once it has been placed, and how far off it may be (m)."""
        target = _required(subgoal.target)
        if target in state.places:
            return state.places[target], 0.0
        if target not in state.poses:
            known = ", ".join(sorted([*state.places, *state.poses]))
            raise Unreachable(f"there is no place or object {target!r}; available: {known}")
        point = self._placing(subgoal)
        return state.poses[target] @ point.object_from_tcp, point.slack_m

    def _placing(self, subgoal: Subgoal) -> InteractionPoint:
        """The point of the target object at which something is placed or dropped."""
        points = self.task.asset(_required(subgoal.target)).points
        placing = {name: point for name, point in points.items() if point.kind in ("place", "drop")}
        name = subgoal.target_point or next(iter(placing), None)
        if name not in placing:
            listed = ", ".join(sorted(placing)) or "none"
            raise Unreachable(f"{subgoal.target} has no place point {name!r}; available: {listed}")
        return placing[name]

    def _above(
        self, subgoal: Subgoal, state: State, tcp_from_object: Matrix, height_m: float
    ) -> list[Matrix]:
        """TCP poses that put the held object at its destination, raised by `height_m`; best first.

        The yaw of what is placed is free, and it may stand off towards the arm by the slack of the
        place: another turn, or a little nearer, may be reachable where the exact pose is not.
        """
        world_from_object, slack_m = self._destination(subgoal, state)
        towards_arm = self.arms[subgoal.agent].world_from_base[:2, 3] - world_from_object[:2, 3]
        towards_arm /= np.linalg.norm(towards_arm)
        goals = []
        for offset_m in (0.0, slack_m / 2, slack_m) if slack_m else (0.0,):
            raised = world_from_object.copy()
            raised[:2, 3] += offset_m * towards_arm
            raised[2, 3] += height_m
            turns = np.deg2rad([0, 90, -90, 180, 45, -45, 135, -135])
            goals += [raised @ transform(rotation=_yaw(turn)) @ inverse(tcp_from_object) for turn in turns]
        return goals

    def _reach(
        self,
        agent: int,
        goals: Iterable[Matrix],
        standoff_m: float,
        state: State,
        touches: frozenset[str],
        what: str,
        *,
        down: bool = False,
    ) -> NDArray[np.float64]:
        """Timed points (T, 7) to the first goal that can be reached, ending with a straight approach.

        The approach comes along the tool's z axis from `standoff_m` away, or straight down.
        Free motion and approach are one motion with a rounded corner.
        """
        reasons = []
        for pre, line in self._candidates(agent, goals, standoff_m, state, down):
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

    def _candidates(
        self, agent: int, goals: Iterable[Matrix], standoff_m: float, state: State, down: bool
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """(joints before the approach, joint points of the approach).

        Goals that come `down` are in order of preference; others are equal, so the cheapest motion
        comes first.
        """
        arm, current = self.arms[agent], state.qpos[agent]
        found = []
        for goal in goals:
            pre = goal.copy() if down else goal @ transform((0.0, 0.0, -standoff_m))
            if down:
                pre[2, 3] += standoff_m
            for seed in self._seeds(agent, goal, current, bool(found)):
                joints = arm.solve(pre, seed)
                line = None if joints is None else self._line(agent, joints, pre, goal)
                if joints is not None and line is not None:
                    cost = np.abs(joints - current).max() + np.abs(line[-1] - line[0]).max()
                    found.append((round(float(cost), 6), len(found), joints, line))
                    break
            if down and found:
                yield found.pop()[2:]
        for _, _, joints, line in sorted(found, key=lambda item: item[:2]):
            yield joints, line

    def _seeds(self, agent: int, goal: Matrix, current: NDArray[np.float64], found: bool):
        yield current
        facing = self._facing(agent, goal)
        yield facing
        if not found:
            for _ in range(_RANDOM_SEEDS):
                yield facing + self.rng.normal(0.0, 0.6, 7)

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


def _turned(goal: Matrix, turns: int) -> list[Matrix]:
    """The pose and those that equal turns about its z axis give."""
    angles = np.linspace(0.0, 2 * np.pi, turns, endpoint=False)
    return [goal @ transform(rotation=_yaw(angle)) for angle in angles]


def _yaw(angle_rad: float) -> Rotation:
    return Rotation.from_euler("z", angle_rad)


def _pitch(angle_rad: float) -> Rotation:
    return Rotation.from_euler("y", angle_rad)
