"""How an arm gets somewhere: postures, straight approaches, free paths, one timed motion of it all."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.datagen.motion.path import find_path
from rf_exp.datagen.motion.state import Blocked, Obstacle, State, Unreachable, name_of
from rf_exp.datagen.motion.timing import blend, densify, parameterise
from rf_exp.findings import Cause, Finding
from rf_exp.robots import Panda
from rf_exp.tasks.base import REST_QPOS
from rf_exp.transforms import Matrix, interpolate, inverse, transform
from rf_exp.types import JointLimits

LINE_STEP_M = 0.01  # between inverse kinematics solutions on a straight line
BLEND_RAD = (0.15, 0.06, 0.02)  # corners are rounded over this; less where that runs into something
CLEARANCE_M = 0.10  # above a place from which things are lowered
RISE_M = 0.04  # straight up from where a thing lies, before it goes anywhere else
_RANDOM_SEEDS, _SPREAD_RAD = 12, 0.6  # inverse kinematics restarts when the natural ones fail
_SWIVELS = np.array([[turn, 0, -turn, 0, 0, 0, 0] for turn in (-0.7, 0.7)])  # rad, the elbow to a side
_SAME_RAD = 0.05  # solutions nearer than this are one
_MAX_JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch

Points = NDArray[np.float64]  # (K, 7) rad
Tiers = Sequence[Sequence[Matrix]]  # TCP poses; those of one tier serve equally, a later one is a last resort
Onward = Callable[
    [int, Points, Matrix], float | None
]  # (agent, joints (7,), TCP pose) -> cost in rad or None


@dataclass(frozen=True)
class Reach:
    """Plans motions of single arms. `blocked` knows the obstacles that the row lets it see."""

    arms: Mapping[int, Panda]
    limits: JointLimits
    blocked: Blocked
    rng: np.random.Generator

    def timed(
        self,
        agent: int,
        tiers: Tiers,
        standoff_m: float,
        state: State,
        touches: frozenset[str],
        what: str,
        *,
        down: bool = False,
        rise: bool = False,
        onward: Onward | None = None,
    ) -> Points:
        """Timed points (T, 7) to the first goal that can be reached, ending with a straight approach.

        The approach comes along the tool's z axis from `standoff_m` away, or straight down. With `rise`
        the motion begins straight up. All of it is one motion with rounded corners.
        """
        obstacles: dict[Obstacle, None] = {}  # what was in the way, in the order in which it was found
        no_path = False
        up = self._rise(agent, state.qpos[agent]) if rise else state.qpos[agent][None]
        for pre, line in self._ways(agent, up[-1], tiers, standoff_m, down, onward):
            if obstacle := self.blocked(agent, line, state, touches):  # cheaper to find out than a path
                obstacles[obstacle] = None
                continue
            path = self._path(agent, up[-1], pre, state)
            if path is None:
                no_path = True
                continue
            corners = densify(np.concatenate([up, path, line]))
            for radius_rad in BLEND_RAD:
                points = blend(corners, radius_rad)
                obstacle = self.blocked(agent, points, state, touches, between=True)
                if obstacle is None:
                    return parameterise(points, self.limits)
                if radius_rad == BLEND_RAD[-1]:
                    obstacles[obstacle] = None
        if not obstacles and not no_path:
            raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(what,))
        agents = agent, *(each for each in obstacles if isinstance(each, int))
        blocked = {"subgoals": (what,), "obstacles": tuple(map(name_of, obstacles))}
        raise Unreachable(Cause.SPACE, Finding.BLOCKED if obstacles else Finding.NO_PATH, agents, **blocked)

    def _ways(
        self, agent: int, start: Points, tiers: Tiers, standoff_m: float, down: bool, onward: Onward | None
    ) -> Iterator[tuple[Points, Points]]:
        """(joints before the approach, joint points of the approach), tier by tier the shortest first.

        Those from which what comes next cannot be reached come last of all.
        """
        last = []
        for tier in tiers:
            found = []
            for goal in tier:
                pre = above(goal, standoff_m) if down else goal @ transform((0.0, 0.0, -standoff_m))
                for joints, line in self._lines(agent, pre, goal, start, bool(found)):
                    cost = np.abs(joints - start).max() + length_rad(line)
                    more = onward(agent, line[-1], goal) if onward else 0.0
                    way = (round(float(cost + (more or 0.0)), 6), len(found), joints, line)
                    (last if more is None else found).append(way)
            for _, _, joints, line in sorted(found, key=lambda way: way[:2]):
                yield joints, line
        for _, _, joints, line in last:
            yield joints, line

    def _lines(
        self, agent: int, pre: Matrix, goal: Matrix, current: Points, found: bool
    ) -> Iterator[tuple[Points, Points]]:
        """Distinct (joints at `pre`, joint points from there to `goal`) of one goal.

        The arm has a joint to spare, so one pose has many postures; some lead through stretched arms,
        where a short line takes long.
        """
        known: list[Points] = []
        facing = self._facing(agent, goal)

        def guesses() -> Iterator[Points]:
            yield from (current, facing, *(facing + swivel for swivel in _SWIVELS))
            for _ in range(_RANDOM_SEEDS):
                if known or found:
                    break
                yield facing + self.rng.normal(0.0, _SPREAD_RAD, 7)

        for seed in guesses():
            joints = self.arms[agent].solve(pre, seed)
            if joints is None or any(np.abs(joints - other).max() < _SAME_RAD for other in known):
                continue
            line = self.line(agent, joints, pre, goal)
            if line is not None:
                known.append(joints)
                yield joints, line

    def _facing(self, agent: int, goal: Matrix) -> Points:
        """Joints (7,) of an arm at rest, turned towards a TCP pose: a good first guess."""
        in_base = inverse(self.arms[agent].world_from_base) @ goal
        return np.array([np.arctan2(in_base[1, 3], in_base[0, 3]), *REST_QPOS[1:]])

    def line(self, agent: int, joints: Points, start: Matrix, goal: Matrix) -> Points | None:
        """Joint points (K, 7) of the straight TCP line from `start` (where `joints` is) to `goal`."""
        count = max(1, int(np.ceil(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / LINE_STEP_M - 1e-6)))
        points = [joints]
        for fraction in np.arange(1, count + 1) / count:
            solution = self.arms[agent].solve(interpolate(start, goal, fraction), points[-1])
            if solution is None or np.abs(solution - points[-1]).max() > _MAX_JUMP_RAD:
                return None
            points.append(solution)
        return np.array(points)

    def _rise(self, agent: int, joints: Points) -> Points:
        """Joint points (K, 7) straight up from where the arm is; only that where it cannot rise."""
        tcp = self.arms[agent].tcp(joints)
        line = self.line(agent, joints, tcp, above(tcp, RISE_M))
        return joints[None] if line is None else line

    def _path(self, agent: int, start: Points, goal: Points, state: State) -> Points | None:
        held = frozenset({state.held[agent][0]}) if agent in state.held else frozenset()

        def free(points: Points) -> bool:
            return self.blocked(agent, points, state, held) is None

        return find_path(start, goal, free, self.rng)

    def freely(self, agent: int, goal: Points, state: State, what: str) -> Points:
        """Timed points (T, 7) to joints (7,). Raises Unreachable."""
        path = self._path(agent, state.qpos[agent], goal, state)
        if path is None:
            raise Unreachable(Cause.SPACE, Finding.NO_PATH, (agent,), subgoals=(what,))
        return parameterise(blend(densify(path), BLEND_RAD[0]), self.limits)

    def arrive(self, agent: int, goal: Matrix, joints: Points) -> Points | None:
        """Joints (3, 7) now, well above a TCP pose, and there; None where inverse kinematics fails."""
        arm, raised = self.arms[agent], above(goal, CLEARANCE_M)
        for seed in (joints, self._facing(agent, goal)):
            high = arm.solve(raised, seed)
            low = None if high is None else arm.solve(goal, high)
            if high is not None and low is not None:
                return np.stack([joints, high, low])
        return None


def above(pose: Matrix, height_m: float) -> Matrix:
    raised = pose.copy()
    raised[2, 3] += height_m
    return raised


def length_rad(points: Points) -> float:
    """Length of a joint path (K, 7): what it costs in time, but for starting and stopping."""
    return float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())


def turned(goal: Matrix, turns: int) -> list[Matrix]:
    """The pose and those that equal turns about its z axis give."""
    angles = np.linspace(0.0, 2 * np.pi, turns, endpoint=False)
    return [goal @ transform(rotation=Rotation.from_euler("z", angle)) for angle in angles]
