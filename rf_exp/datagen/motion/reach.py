"""Motion planning of single arms: postures, straight approaches, free paths, joined into one timed motion."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from heapq import heapify, heappop, heappush

import numpy as np

from rf_exp.datagen.motion.branches import Approaches, Arrivals, along, leaving_s, straight
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.state import Blockage, Blocked, Floats, Points, State, Unreachable, obstructed
from rf_exp.datagen.motion.timing import SPACING_RAD, blend, densify, duration_s, parameterise
from rf_exp.findings import Cause, Finding
from rf_exp.robots import Arm
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, equal_turns, transform
from rf_exp.types import JointLimits

BLEND_RAD = (0.15, 0.06, 0.02)  # corners are rounded over this; less where that collides
CLEARANCE_M = 0.10  # height above a place at which lowering begins
RISE_M = 0.04  # straight rise of a grasped object before it moves elsewhere

Tiers = Sequence[Sequence[Matrix]]  # TCP poses, equivalent within a tier; later tiers are a last resort


@dataclass(frozen=True)
class LookAhead:
    """Estimate of what comes after a motion.

    `after` takes goals, TCP poses (G, 4, 4), and returns a function of the index of one and the straight
    approach to it (2, dof), which gives the duration in s; infinite: out of reach. `leaves` tells whether the
    next motion can begin from joints (dof,) at the goal; where it cannot, other goals come first.
    """

    after: Callable[[Floats], Callable[[int, Points], float]]
    rest_rad: Points | None = None  # (dof,) where the arm goes then, if known beforehand
    leaves: Callable[[Points], bool] = lambda joints: True


_NOTHING = LookAhead(lambda _: lambda goal, points: 0.0)


@dataclass(frozen=True)
class Reach:
    """Motion planner for single arms. `blocked` tests the obstacles that the constraints let it see."""

    arms: Mapping[int, Arm]
    limits: JointLimits
    blocked: Blocked
    search: Search

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
        round_it: bool = False,
        look_ahead: LookAhead = _NOTHING,
    ) -> Points:
        """Timed points (T, dof) to the first goal in reach: one motion with rounded corners.

        It ends with a straight approach from a pre-grasp pose, `standoff_m` back along the tool's z axis or,
        with `down`, as far above the goal. With `rise` it begins straight up. With `round_it` a rounded
        detour keeps clear of what the gripper may touch at the end. Raises Unreachable.
        """
        obstacles: dict[int | str, Blockage] = {}  # in the order in which they were found
        no_path, blocked = False, partial(self.blocked, agent, state=state, touches=touches)
        no_room: set[tuple[int, int]] = set()  # goals where the gripper alone collides, or without a way on
        stuck: Points | None = None  # the fastest motion to a goal without a way on
        start = state.qpos[agent]
        risen = self.risen(agent, start) if rise else None
        up = start[None] if risen is None else risen
        for goal, line in self._straight_lines(agent, up, tiers, standoff_m, down, look_ahead, no_room):
            if obstacle := blocked(line):  # cheaper to test than a path
                obstacles.setdefault(obstacle, Blockage(agent, line, state, touches, obstacle))
                if blocked(line[-1:], hand=True):
                    no_room.add(goal)
                continue
            path = self._path(agent, up[-1], line[0], state)
            if path is None:
                no_path = True
                continue
            corners = densify(np.concatenate([up, path, line]))
            for radius_rad in BLEND_RAD:
                points = blend(corners, radius_rad)
                obstacle = None
                if round_it and len(path) > 2:
                    begins = int(np.abs(corners - line[0]).max(axis=1).argmin())  # rounding begins earlier
                    detour = points[: max(1, begins - int(1.5 * radius_rad / SPACING_RAD))]
                    obstacle = self.blocked(agent, detour, state, state.in_hand(agent), between=True)
                obstacle = obstacle or blocked(points, between=True)
                if obstacle is None:
                    if look_ahead.leaves(points[-1]):
                        return parameterise(points, self.limits)
                    stuck = points if stuck is None else stuck
                    no_room.add(goal)
                    break
                if radius_rad == BLEND_RAD[-1]:
                    obstacles.setdefault(obstacle, Blockage(agent, points, state, touches, obstacle))
            # All lines begin with the rise, so it is tested once.
            if risen is not None and (obstacle := blocked(risen, between=True)):
                raise obstructed(what, Blockage(agent, risen, state, touches, obstacle, "as it rises"))
            risen = None
        if stuck is not None:  # the obstacle is reported when the next subgoal is planned
            return parameterise(stuck, self.limits)
        if obstacles:
            everywhere = len(no_room) == sum(map(len, tiers))
            finding = Finding.NO_ROOM if everywhere else Finding.BLOCKED
            raise obstructed(what, *obstacles.values(), finding=finding)
        cause, finding = (Cause.SPACE, Finding.NO_PATH) if no_path else (Cause.REACH, Finding.OUT_OF_REACH)
        raise Unreachable(cause, finding, (agent,), subgoals=(what,))

    def estimated_s(
        self, agent: int, tiers: Tiers, standoff_m: float, state: State, look_ahead: LookAhead
    ) -> float:
        """Estimated duration to the fastest goal of `timed`, with what comes next; infinite: there is none.

        The goal is one of the first tier with a reachable one.
        """
        arm, before = self.arms[agent], state.qpos[agent][None]
        for goals in map(np.stack, tiers):
            least_s, more_s = np.inf, look_ahead.after(goals)
            approaches = Approaches(arm, self.limits, drawn_back(goals, standoff_m), goals, before)
            for each in sorted(approaches.estimated(look_ahead.rest_rad), key=lambda each: each.takes_s):
                if each.takes_s >= least_s:
                    break
                least_s = min(least_s, each.takes_s + more_s(each.goal, each.points))
            if np.isfinite(least_s):
                return least_s
        return np.inf

    def _straight_lines(
        self,
        agent: int,
        up: Points,
        tiers: Tiers,
        standoff_m: float,
        down: bool,
        look_ahead: LookAhead,
        given_up: Collection[tuple[int, int]],
    ) -> Iterator[tuple[tuple[int, int], Points]]:
        """Joint points of approaches that follow the points `up`, tier by tier, the fastest first.

        Each comes with its tier and the index of its goal there; a goal `given_up` meanwhile does not come
        again. An approach is made exact only when its estimate is below all exact ones. Approaches after
        which the next motion is out of reach come last of all.
        """
        last, before = [], up[[0, -1]] if len(up) > 1 else up
        for tier, goals in enumerate(map(np.stack, tiers)):
            pregrasps = above(goals, standoff_m) if down else drawn_back(goals, standoff_m)
            approaches = Approaches(self.arms[agent], self.limits, pregrasps, goals, before)
            more_s = look_ahead.after(goals)
            # What comes next is estimated only where the way alone takes no longer than all of another one.
            open_ = [
                (round(each.takes_s, 6), number, False, each)
                for number, each in enumerate(approaches.estimated(look_ahead.rest_rad))
            ]
            heapify(open_)
            while open_:
                altogether_s, number, counted, way = heappop(open_)
                goal = tier, way.goal
                if goal in given_up:
                    continue
                if not counted:
                    altogether_s = round(way.takes_s + more_s(way.goal, way.points[[0, -1]]), 6)
                    heappush(open_, (altogether_s, number, True, way))
                elif not way.exact:
                    exact = approaches.exact(way)
                    if exact is not None:
                        heappush(open_, (round(exact.takes_s, 6), number, False, exact))
                elif np.isfinite(altogether_s):
                    yield goal, way.points
                else:
                    last.append((goal, way.points))
        yield from (each for each in last if each[0] not in given_up)

    def _path(self, agent: int, start: Points, goal: Points, state: State) -> Points | None:
        def free(points: Points) -> bool:
            return self.blocked(agent, points, state, state.in_hand(agent)) is None

        return self.search.path(start, goal, free, self.arms[agent].robot.limits_rad)

    def freely(self, agent: int, goal: Points, state: State, what: str) -> Points:
        """Timed points (T, dof) on a free path to joints (dof,). Raises Unreachable."""
        path = self._path(agent, state.qpos[agent], goal, state)
        if path is not None:
            return parameterise(blend(densify(path), BLEND_RAD[0]), self.limits)
        held = state.in_hand(agent)
        at_an_end = (  # otherwise the obstacle is somewhere between
            Blockage(agent, joints[None], state, held, obstacle, where)
            for joints, where in ((state.qpos[agent], "where it stands"), (goal, "where it is to go"))
            if (obstacle := self.blocked(agent, joints[None], state, held))
        )
        raise Unreachable(Cause.SPACE, Finding.NO_PATH, (agent,), next(at_an_end, None), subgoals=(what,))

    def line(self, agent: int, joints: Points, goal: Matrix) -> Points | None:
        """Joint points (K, dof) of the straight TCP line from joints (dof,) to a pose."""
        return straight(self.arms[agent], joints, goal, self.limits)

    def risen(self, agent: int, joints: Points) -> Points | None:
        """Joint points (K, dof) of the line straight up with which a grasped object begins to move."""
        return self.line(agent, joints, above(self.arms[agent].tcp(joints), RISE_M))

    def along(self, agent: int, joints: Points, poses: Floats) -> Points | None:
        """Joint points (K + 1, dof) from joints (dof,) through TCP poses (K, 4, 4)."""
        return along(self.arms[agent], joints, poses, self.limits)

    def arrive(
        self, agent: int, tiers: Tiers, rest_rad: Points | None = None
    ) -> Callable[[Points], Points | None]:
        """Function of a motion (K, dof) that gives joints (3, dof): at its end, above a TCP pose, and at it.

        The pose is one of the first tier in reach; the way is the fastest, including that to `rest_rad`.
        """
        stacked = [np.stack(tier) for tier in tiers]
        arrivals = cache(
            lambda k: Arrivals(self.arms[agent], above(stacked[k], CLEARANCE_M), stacked[k], rest_rad)
        )

        def nearest(points: Points) -> Points | None:
            for k in range(len(stacked)):
                found = arrivals(k).nearest(points[-1])
                takes_s = self.duration_s(found)
                if rest_rad is not None:
                    takes_s = takes_s + leaving_s(found[:, 1], found[:, 2], rest_rad, self.limits)
                if np.isfinite(takes_s).any():
                    return found[takes_s.argmin()]
            return None

        return nearest

    def duration_s(self, corners: Floats) -> Floats:
        """(...) s, estimated duration of motions round corners (..., K, dof)."""
        return duration_s(corners, self.limits)


def above(poses: Floats, height_m: float) -> Floats:
    """Poses (..., 4, 4), raised by `height_m`."""
    raised = poses.copy()
    raised[..., 2, 3] += height_m
    return raised


def drawn_back(poses: Floats, by_m: float) -> Floats:
    """Poses (..., 4, 4), moved back along the z axis of the tool."""
    return poses @ transform((0.0, 0.0, -by_m))


def turned(goal: Matrix, turns: int) -> list[Matrix]:
    """The pose, and its copies by equal turns about its z axis."""
    return [goal @ turn for turn in equal_turns(turns)]


def contacts(world_from_object: Matrix, point: InteractionPoint) -> list[Matrix]:
    """All equivalent TCP poses in which a gripper meets an object at a point."""
    return [hand for alike in point.alike for hand in turned(world_from_object @ alike, point.turns)]
