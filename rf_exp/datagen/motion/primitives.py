"""Motion primitives: each subgoal becomes rest-to-rest segments of one agent (paper, supplementary A).

A subgoal is carried out from the state in which the previous one leaves the agent, so a whole
proposal is planned ahead of its execution. `State` is that predicted state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.datagen.motion.destination import ends, support
from rf_exp.datagen.motion.reach import CLEARANCE_M, Onward, Reach, Tiers, above, length_rad, turned
from rf_exp.datagen.motion.state import State, Unreachable, name_of
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.findings import Cause, Finding
from rf_exp.tasks import Task
from rf_exp.tasks.base import ASIDE_QPOS
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Segment, Subgoal

GRIPPER_STEPS = 8  # control steps that closing or opening takes, 0.4 s
RETREAT_M = 0.08
_TIPS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
_WITH_HELD = ("lift", "carry", "place", "strike")  # verbs that move what is held

T = TypeVar("T")


@dataclass(frozen=True)
class Primitives:
    """Plans single subgoals of a task."""

    task: Task
    reach: Reach

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
            raise Unreachable(Cause.GRIP, Finding.HOLDS_OTHER, (agent,), object=state.held[agent][0])
        point = self.task.asset(name).points[_required(subgoal.point)]
        touches = frozenset({name})
        goals = turned(state.poses[name] @ point.object_from_tcp, point.turns)
        tips = [transform(rotation=_pitch(np.deg2rad(tip))) for tip in _TIPS_DEG if abs(tip) <= point.tip_deg]
        points = self.reach.timed(
            agent,
            [[goal @ tip for goal in goals] for tip in tips],
            point.standoff_m,
            state,
            touches,
            f"grasp {name} at {subgoal.point}",
            onward=self._onward(following, name, state),
        )
        segments = [self._segment(subgoal, "approach", points, state, touches)]
        segments.append(self._fingers(subgoal, "close", GRIPPER_CLOSED, state, touches))
        tcp_from_object = inverse(self.reach.arms[agent].tcp(state.qpos[agent])) @ state.poses[name]
        state.held[agent] = (name, tcp_from_object)
        return segments

    def _lift(self, subgoal: Subgoal, state: State) -> list[Segment]:
        line = self.lift_line(subgoal, state)
        return [self._segment(subgoal, "lift", parameterise(line, self.reach.limits), state)]

    def _carry(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (_, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        points = self.reach.timed(agent, goals, 0.0, state, frozenset(), subgoal.text, rise=True)
        return [self._segment(subgoal, "carry", points, state)]

    def _place(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (name, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        touches = frozenset({name}) | support(self.task, subgoal)
        points = self.reach.timed(
            agent, goals, CLEARANCE_M, state, touches, subgoal.text, down=True, rise=True
        )
        segments = [self._segment(subgoal, "lower", points, state, touches)]
        return [*segments, *self._let_go(subgoal, state, touches)]

    def _strike(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, (name, tcp_from_object) = subgoal.agent, self._holding(subgoal, state)
        goals = self._ends(subgoal, state, tcp_from_object)
        touches = frozenset({name, _required(subgoal.target)})
        points = self.reach.timed(agent, goals, CLEARANCE_M, state, touches, subgoal.text, down=True)
        return [self._segment(subgoal, "strike", points, state, touches)]

    def _release(self, subgoal: Subgoal, state: State) -> list[Segment]:
        name, _ = self._holding(subgoal, state)
        return self._let_go(subgoal, state, frozenset({name}))

    def _press(self, subgoal: Subgoal, state: State) -> list[Segment]:
        agent, name = subgoal.agent, _required(subgoal.object)
        point = self.task.asset(name).points[_required(subgoal.point)]
        goals = turned(state.poses[name] @ point.object_from_tcp, point.turns)
        touches = frozenset({name})
        segments = [self._fingers(subgoal, "close", GRIPPER_CLOSED, state)]
        points = self.reach.timed(
            agent, [goals], point.standoff_m, state, touches, f"press {name} at {subgoal.point}"
        )
        return [*segments, self._segment(subgoal, "press", points, state, touches)]

    def leave(self, subgoal: Subgoal, state: State) -> list[Segment]:
        """Home or aside, on a free path."""
        rest = self.task.robots[subgoal.agent - 1].rest_rad
        joints = np.array(ASIDE_QPOS if subgoal.verb == "aside" else rest)
        points = self.reach.freely(subgoal.agent, joints, state, f"go {subgoal.verb}")
        return [self._segment(subgoal, "move", points, state)]

    _home = _aside = leave

    def _hold(self, subgoal: Subgoal, state: State) -> list[Segment]:
        return []

    # -- what the verbs are made of ----------------------------------------------------------------

    def _onward(self, subgoals: Sequence[Subgoal], name: str, state: State) -> Onward:
        """The cost of what an agent does next with an object, once it holds it as from some TCP pose."""
        with_it = [each for each in subgoals if each.object == name and each.verb in _WITH_HELD]

        def cost_rad(agent: int, joints: NDArray[np.float64], goal: Matrix) -> float | None:
            tcp_from_object, total = inverse(goal) @ state.poses[name], 0.0
            for each in with_it:
                if each.verb == "lift":
                    raised = self.reach.arms[agent].tcp(joints)
                    line = self.reach.line(agent, joints, raised, above(raised, _required(each.height_m)))
                else:
                    try:
                        tiers = self._ends(each, state, tcp_from_object)
                    except Unreachable:  # that will be said when its turn comes
                        return total
                    ways = (self.reach.arrive(agent, end, joints) for tier in tiers for end in tier)
                    line = min((way for way in ways if way is not None), key=length_rad, default=None)
                if line is None:
                    return None
                total, joints = total + length_rad(line), line[-1]
            return total

        return cost_rad

    def _ends(self, subgoal: Subgoal, state: State, tcp_from_object: Matrix) -> Tiers:
        return ends(self.task, self.reach.arms[subgoal.agent], subgoal, state, tcp_from_object)

    def lift_line(self, subgoal: Subgoal, state: State) -> NDArray[np.float64]:
        """Joint points (K, 7) of a lift straight up; K depends on the height alone."""
        self._holding(subgoal, state)
        start = self.reach.arms[subgoal.agent].tcp(state.qpos[subgoal.agent])
        goal = above(start, _required(subgoal.height_m))
        line = self.reach.line(subgoal.agent, state.qpos[subgoal.agent], start, goal)
        if line is None:
            raise Unreachable(Cause.REACH, Finding.TOO_HIGH, (subgoal.agent,), subgoals=(subgoal.text,))
        if obstacle := self.reach.blocked(subgoal.agent, line, state, self._touches_lifting(subgoal, state)):
            agents = (subgoal.agent, obstacle) if isinstance(obstacle, int) else (subgoal.agent,)
            blocked = {"subgoals": (subgoal.text,), "obstacles": (name_of(obstacle),)}
            raise Unreachable(Cause.SPACE, Finding.BLOCKED, agents, **blocked)
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
        start = self.reach.arms[agent].tcp(state.qpos[agent])
        line = self.reach.line(agent, state.qpos[agent], start, start @ transform((0.0, 0.0, -RETREAT_M)))
        if line is None:
            raise Unreachable(Cause.REACH, Finding.NO_RETREAT, (agent,), object=subgoal.object)
        return [
            opened,
            self._segment(subgoal, "retreat", parameterise(line, self.reach.limits), state, touches),
        ]

    def _holding(self, subgoal: Subgoal, state: State) -> tuple[str, Matrix]:
        held = state.held.get(subgoal.agent)
        if held is None or held[0] != subgoal.object:
            missing = {"subgoals": (subgoal.text,), "object": subgoal.object}
            raise Unreachable(Cause.GRIP, Finding.HOLDS_NOT, (subgoal.agent,), **missing)
        return held

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
            state.poses[name] = self.reach.arms[agent].tcp(state.qpos[agent]) @ tcp_from_object
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


def _pitch(angle_rad: float) -> Rotation:
    return Rotation.from_euler("y", angle_rad)
