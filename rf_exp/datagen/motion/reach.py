"""Motion planning of single arms: postures, straight approaches, free paths, joined into one timed motion."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from heapq import heapify, heappop, heappush

import numpy as np

from rf_exp.datagen.motion.branches import Approaches, Arrivals, departure_s, path_through, straight_line
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.state import (
    Blockage,
    Blocked,
    Floats,
    Points,
    State,
    Unreachable,
    obstruction_error,
)
from rf_exp.datagen.motion.timing import SPACING_RAD, blend, densify, duration_s, parameterise
from rf_exp.findings import Cause, Finding
from rf_exp.robots import Arm
from rf_exp.tasks.assets import InteractionPoint
from rf_exp.transforms import Matrix, equal_rotations, transform
from rf_exp.types import JointLimits

BLEND_RAD = (0.15, 0.06, 0.02)  # corners are rounded over this; less where that collides
PREPLACE_HEIGHT_M = 0.10  # height above a place at which lowering begins
RISE_M = 0.04  # straight rise of a grasped object before it moves elsewhere

Tiers = Sequence[Sequence[Matrix]]  # TCP poses, equivalent within a tier; later tiers are a last resort


@dataclass(frozen=True)
class LookAhead:
    """Estimate of what comes after a motion.

    `cost_to_go` takes goals, TCP poses (G, 4, 4), and returns a function of the index of one and the straight
    approach to it (2, dof), which gives the duration in s; infinite: out of reach. `can_continue` tells
    whether the next motion can begin from joints (dof,) at the goal; where it cannot, other goals come first.
    """

    cost_to_go: Callable[[Floats], Callable[[int, Points], float]]
    rest_rad: Points | None = None  # (dof,) where the arm goes then, if known beforehand
    can_continue: Callable[[Points], bool] = lambda joints: True


_NO_LOOK_AHEAD = LookAhead(lambda _: lambda goal, points: 0.0)


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
        subgoal_text: str,
        *,
        from_above: bool = False,
        rise: bool = False,
        avoid_touched: bool = False,
        look_ahead: LookAhead = _NO_LOOK_AHEAD,
    ) -> Points:
        """Timed points (T, dof) to the first goal in reach: one motion with rounded corners.

        It ends with a straight approach from a pre-grasp pose, `standoff_m` back along the tool's z axis or,
        with `from_above`, as far above the goal. With `rise` it begins straight up. With `avoid_touched` a
        rounded detour keeps clear of what the gripper may touch at the end. Raises Unreachable.
        """
        obstacles: dict[int | str, Blockage] = {}  # in the order in which they were found
        no_path, blocked = False, partial(self.blocked, agent, state=state, touches=touches)
        excluded: set[tuple[int, int]] = set()  # goals where the gripper alone collides, or without a way on
        dead_end: Points | None = None  # the fastest motion to a goal without a way on
        start = state.qpos[agent]
        rise_line = self.rise_line(agent, start) if rise else None
        begin = start[None] if rise_line is None else rise_line
        lines = self._approach_lines(agent, begin, tiers, standoff_m, from_above, look_ahead, excluded)
        for goal, line in lines:
            if obstacle := blocked(line):  # cheaper to test than a path
                obstacles.setdefault(obstacle, Blockage(agent, line, state, touches, obstacle))
                if blocked(line[-1:], gripper_only=True):
                    excluded.add(goal)
                continue
            path = self._path(agent, begin[-1], line[0], state)
            if path is None:
                no_path = True
                continue
            corners = densify(np.concatenate([begin, path, line]))
            for radius_rad in BLEND_RAD:
                points = blend(corners, radius_rad)
                obstacle = None
                if avoid_touched and len(path) > 2:
                    # Rounding begins earlier.
                    line_start = int(np.abs(corners - line[0]).max(axis=1).argmin())
                    detour = points[: max(1, line_start - int(1.5 * radius_rad / SPACING_RAD))]
                    obstacle = self.blocked(agent, detour, state, state.in_hand(agent), between=True)
                obstacle = obstacle or blocked(points, between=True)
                if obstacle is None:
                    if look_ahead.can_continue(points[-1]):
                        return parameterise(points, self.limits)
                    dead_end = points if dead_end is None else dead_end
                    excluded.add(goal)
                    break
                if radius_rad == BLEND_RAD[-1]:
                    obstacles.setdefault(obstacle, Blockage(agent, points, state, touches, obstacle))
            # All lines begin with the rise, so it is tested once.
            if rise_line is not None and (obstacle := blocked(rise_line, between=True)):
                blockage = Blockage(agent, rise_line, state, touches, obstacle, "as it rises")
                raise obstruction_error(subgoal_text, blockage)
            rise_line = None
        if dead_end is not None:  # the obstacle is reported when the next subgoal is planned
            return parameterise(dead_end, self.limits)
        if obstacles:
            all_excluded = len(excluded) == sum(map(len, tiers))
            finding = Finding.NO_ROOM if all_excluded else Finding.BLOCKED
            raise obstruction_error(subgoal_text, *obstacles.values(), finding=finding)
        cause, finding = (Cause.SPACE, Finding.NO_PATH) if no_path else (Cause.REACH, Finding.OUT_OF_REACH)
        raise Unreachable(cause, finding, (agent,), subgoals=(subgoal_text,))

    def estimated_s(
        self, agent: int, tiers: Tiers, standoff_m: float, state: State, look_ahead: LookAhead
    ) -> float:
        """Estimated duration to the fastest goal of `timed`, with what comes next; infinite: there is none.

        The goal is one of the first tier with a reachable one.
        """
        arm, before = self.arms[agent], state.qpos[agent][None]
        for goals in map(np.stack, tiers):
            least_s, cost_to_go_s = np.inf, look_ahead.cost_to_go(goals)
            approaches = Approaches(arm, self.limits, drawn_back(goals, standoff_m), goals, before)
            estimates = approaches.estimated(look_ahead.rest_rad)
            for approach in sorted(estimates, key=lambda each: each.duration_s):
                if approach.duration_s >= least_s:
                    break
                least_s = min(least_s, approach.duration_s + cost_to_go_s(approach.goal, approach.points))
            if np.isfinite(least_s):
                return least_s
        return np.inf

    def _approach_lines(
        self,
        agent: int,
        begin: Points,
        tiers: Tiers,
        standoff_m: float,
        from_above: bool,
        look_ahead: LookAhead,
        excluded: Collection[tuple[int, int]],
    ) -> Iterator[tuple[tuple[int, int], Points]]:
        """Joint points of approaches that follow the points `begin`, tier by tier, the fastest first.

        Each comes with its tier and the index of its goal there; a goal `excluded` meanwhile does not come
        again. An approach is made exact only when its estimate is below all exact ones. Approaches after
        which the next motion is out of reach come last of all.
        """
        postponed, before = [], begin[[0, -1]] if len(begin) > 1 else begin
        for tier, goals in enumerate(map(np.stack, tiers)):
            pregrasps = above(goals, standoff_m) if from_above else drawn_back(goals, standoff_m)
            approaches = Approaches(self.arms[agent], self.limits, pregrasps, goals, before)
            cost_to_go_s = look_ahead.cost_to_go(goals)
            # What comes next is estimated only where the way alone takes no longer than all of another one.
            queue = [
                (round(approach.duration_s, 6), number, False, approach)
                for number, approach in enumerate(approaches.estimated(look_ahead.rest_rad))
            ]
            heapify(queue)
            while queue:
                total_s, number, is_total, approach = heappop(queue)
                goal = tier, approach.goal
                if goal in excluded:
                    continue
                if not is_total:
                    further_s = cost_to_go_s(approach.goal, approach.points[[0, -1]])
                    total_s = round(approach.duration_s + further_s, 6)
                    heappush(queue, (total_s, number, True, approach))
                elif not approach.exact:
                    exact = approaches.exact(approach)
                    if exact is not None:
                        heappush(queue, (round(exact.duration_s, 6), number, False, exact))
                elif np.isfinite(total_s):
                    yield goal, approach.points
                else:
                    postponed.append((goal, approach.points))
        yield from (each for each in postponed if each[0] not in excluded)

    def _path(self, agent: int, start: Points, goal: Points, state: State) -> Points | None:
        def free(points: Points) -> bool:
            return self.blocked(agent, points, state, state.in_hand(agent)) is None

        return self.search.path(start, goal, free, self.arms[agent].robot.limits_rad)

    def free_motion(self, agent: int, goal: Points, state: State, subgoal_text: str) -> Points:
        """Timed points (T, dof) on a free path to joints (dof,). Raises Unreachable."""
        path = self._path(agent, state.qpos[agent], goal, state)
        if path is not None:
            return parameterise(blend(densify(path), BLEND_RAD[0]), self.limits)
        held_names = state.in_hand(agent)
        blockages = (  # otherwise the obstacle is somewhere between
            Blockage(agent, joints[None], state, held_names, obstacle, place)
            for joints, place in ((state.qpos[agent], "where it stands"), (goal, "where it is to go"))
            if (obstacle := self.blocked(agent, joints[None], state, held_names))
        )
        raise Unreachable(
            Cause.SPACE, Finding.NO_PATH, (agent,), next(blockages, None), subgoals=(subgoal_text,)
        )

    def line(self, agent: int, joints: Points, goal: Matrix) -> Points | None:
        """Joint points (K, dof) of the straight TCP line from joints (dof,) to a pose."""
        return straight_line(self.arms[agent], joints, goal, self.limits)

    def rise_line(self, agent: int, joints: Points) -> Points | None:
        """Joint points (K, dof) of the line straight up with which a grasped object begins to move."""
        return self.line(agent, joints, above(self.arms[agent].tcp(joints), RISE_M))

    def path_through(self, agent: int, joints: Points, poses: Floats) -> Points | None:
        """Joint points (K + 1, dof) from joints (dof,) through TCP poses (K, 4, 4)."""
        return path_through(self.arms[agent], joints, poses, self.limits)

    def arrivals(
        self, agent: int, tiers: Tiers, rest_rad: Points | None = None
    ) -> Callable[[Points], Points | None]:
        """Function of a motion (K, dof) that gives joints (3, dof): at its end, above a TCP pose, and at it.

        The pose is one of the first tier in reach; the way is the fastest, including that to `rest_rad`.
        """
        stacked = [np.stack(tier) for tier in tiers]
        arrivals_of_tier = cache(
            lambda k: Arrivals(self.arms[agent], above(stacked[k], PREPLACE_HEIGHT_M), stacked[k], rest_rad)
        )

        def fastest(points: Points) -> Points | None:
            for k in range(len(stacked)):
                corners = arrivals_of_tier(k).nearest(points[-1])
                durations_s = self.duration_s(corners)
                if rest_rad is not None:
                    _, high, low = np.moveaxis(corners, 1, 0)
                    durations_s = durations_s + departure_s(high, low, rest_rad, self.limits)
                if np.isfinite(durations_s).any():
                    return corners[durations_s.argmin()]
            return None

        return fastest

    def duration_s(self, corners: Floats) -> Floats:
        """(...) s, estimated duration of motions round corners (..., K, dof)."""
        return duration_s(corners, self.limits)


def above(poses: Floats, height_m: float) -> Floats:
    """Poses (..., 4, 4), raised by `height_m`."""
    raised = poses.copy()
    raised[..., 2, 3] += height_m
    return raised


def drawn_back(poses: Floats, distance_m: float) -> Floats:
    """Poses (..., 4, 4), moved back along the z axis of the tool."""
    return poses @ transform((0.0, 0.0, -distance_m))


def symmetric_poses(goal: Matrix, turns: int) -> list[Matrix]:
    """The pose, and its copies by equal turns about its z axis."""
    return [goal @ turn for turn in equal_rotations(turns)]


def contact_poses(world_from_object: Matrix, point: InteractionPoint) -> list[Matrix]:
    """All equivalent TCP poses in which a gripper meets an object at a point."""
    equivalent = (world_from_object @ symmetry for symmetry in point.equivalent_poses)
    return [pose for goal in equivalent for pose in symmetric_poses(goal, point.turns)]
