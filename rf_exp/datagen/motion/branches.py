"""Postures and straight lines of one arm: candidates, and the one that takes the least time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rf_exp.datagen.motion.state import Floats, Points
from rf_exp.datagen.motion.timing import duration_s
from rf_exp.robots import Arm
from rf_exp.transforms import Matrix, interpolate, wrapped_rad
from rf_exp.types import JointLimits

LINE_STEP_M = 0.01  # between the poses of a straight line for which inverse kinematics is solved
AWAY_RAD = np.arange(-15, 16) * (2 * np.pi / 31)  # of the last joint, from where the arm faces the goal
FINE_RAD = np.arange(-4, 5) * 0.04  # about the best of AWAY_RAD
NEXT = (-2, -1, 0, 1, 2)  # steps of AWAY_RAD that the last joint may turn along an approach
APART = 2  # steps of AWAY_RAD between postures that are worth trying one after the other
TRIES = 4  # postures for each goal
TURNS_RAD = np.array([0, *(sign * turn for turn in (0.05, 0.1, 0.2, 0.4, 0.7) for sign in (1, -1))])
JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch
EASE = 0.01  # s/rad, cost of the motion of all joints, added to its duration
UPRIGHT = 0.03  # s/rad, cost of the elbow's angle out of the upright plane, where it is in others' way


@dataclass(frozen=True)
class Approach:
    """Straight approach to a goal; estimated from its two ends until it is `exact`."""

    goal: int  # index of the goal
    takes_s: float  # duration of the motion to its beginning, and along it
    points: Points  # the two ends until it is `exact`
    branch: int  # of the posture in which it begins
    exact: bool = False


@dataclass(frozen=True, eq=False)
class Approaches:
    """Straight approaches from pre-grasp poses to goals.

    For placing and striking, the pre-grasp pose is the one above the place. A redundant arm has many postures
    for one pose; some lead through stretched arms, where a short line takes long.
    """

    arm: Arm
    limits: JointLimits
    pregrasps: Floats  # (G, 4, 4)
    goals: Floats  # (G, 4, 4)
    before: Points  # (M, dof) from which the approach follows

    def estimated(self, rest: Points | None = None) -> Iterator[Approach]:
        """The fastest few for each goal. With `rest` (dof,) rad, going back and on to there counts too."""
        # Postures are (G, R, branches, dof).
        both = self.pregrasps, self.goals
        first, last = (self.arm.postures(poses[:, None], _turns(self.arm, poses)) for poses in both)
        ends = np.stack([np.roll(each, k, axis=1) for each in (last, self.arm.crossed(last)) for k in NEXT])
        nearest = _cost(self.arm, first, ends).argmin(axis=0)
        end = np.take_along_axis(ends, nearest[None, ..., None], axis=0)[0]
        takes_s = self._takes_s(first, end)
        cost = takes_s + self._dislike_s(first, end)
        if rest is not None:
            cost += leaving_s(first, end, rest, self.limits)
        cost = _or_infinite(cost)
        taken: list[tuple[int, int, int]] = []
        for flat in np.argsort(cost, axis=None, kind="stable"):
            goal, turn, branch = map(int, np.unravel_index(flat, cost.shape))
            index = goal, turn, branch
            if not np.isfinite(cost[index]):
                return
            of_goal = [each for each in taken if each[0] == goal]
            near = any(b == branch and abs(t - turn) < APART for _, t, b in of_goal)
            if near or len(of_goal) == TRIES:
                continue
            taken.append(index)
            points = np.stack([first[index], end[index]])
            yield Approach(goal, float(takes_s[index]), points, branch)

    def exact(self, estimate: Approach) -> Approach | None:
        """The approach with all its points (K, dof), or None where there is no such line."""
        goal = self.goals[estimate.goal]
        for begin, end in (self._finer(estimate), estimate.points):
            turns = np.append(TURNS_RAD, end[-1] - begin[-1])
            lines = _through(self.arm, begin, _between(self.arm, begin, goal), turns)
            if len(lines):
                takes_s = self._takes_s(begin, lines[:, lines.shape[1] // 2], lines[:, -1])
                best = int((takes_s + self._dislike_s(begin, lines[:, -1])).argmin())
                return replace(estimate, takes_s=float(takes_s[best]), points=lines[best], exact=True)
        return None

    def _finer(self, estimate: Approach) -> Points:
        """Ends (2, dof) of nearly the same approach that are reached sooner, if there are any."""
        goal, branch = estimate.goal, estimate.branch
        begin, end = estimate.points
        first = self.arm.postures(self.pregrasps[goal], begin[-1] + FINE_RAD)[:, branch, None]
        last = self.arm.postures(self.goals[goal], end[-1] + FINE_RAD)
        last = last[:, [branch, self.arm.beyond(branch)]].reshape(-1, last.shape[-1])
        cost = _or_infinite(self._takes_s(first, last) + self._dislike_s(first, last))
        if not np.isfinite(cost).any():
            return estimate.points
        one, other = np.unravel_index(cost.argmin(), cost.shape)
        return np.stack([first[one, 0], last[other]])

    def _takes_s(self, *after: Floats) -> Floats:
        """(...) s of going through postures (..., dof) in turn."""
        return duration_s(_corners(*self.before, *after), self.limits)

    def _dislike_s(self, begin: Floats, end: Floats) -> Floats:
        """(...) s, penalty of an approach for joint motion, and for an elbow out of the upright plane."""
        return _dislike_s(self.arm, self.before[-1], begin) + _dislike_s(self.arm, begin, end)


def leaving_s(high: Floats, low: Floats, rest: Points, limits: JointLimits) -> Floats:
    """(...) s from postures `low` back up to `high` (..., dof), where an arm stops, and on to `rest`."""
    return duration_s(_corners(low, high), limits) + duration_s(_corners(high, rest), limits)


def straight(arm: Arm, joints: Floats, goal: Matrix, limits: JointLimits) -> Points | None:
    """Joint points (K, dof) of the fastest straight TCP line from joints (dof,) to a pose, or None."""
    return along(arm, joints, _between(arm, joints, goal), limits)


def along(arm: Arm, joints: Floats, poses: Floats, limits: JointLimits) -> Points | None:
    """Joint points (K + 1, dof) of the fastest motion from joints (dof,) through TCP poses (K, 4, 4)."""
    turns = np.append(TURNS_RAD, arm.facing(poses[-1]) - joints[-1])
    lines = _through(arm, joints, poses, turns)
    if not len(lines):
        return None
    middle, end = lines[:, lines.shape[1] // 2], lines[:, -1]
    takes_s = duration_s(_corners(joints, middle, end), limits)
    return lines[(takes_s + _dislike_s(arm, joints, end)).argmin()]


def _between(arm: Arm, joints: Floats, goal: Matrix) -> Floats:
    """(K, 4, 4) TCP poses on the straight line from joints (dof,) to a pose, which comes last."""
    start = arm.tcp(joints)
    count = max(1, int(np.ceil(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / LINE_STEP_M - 1e-6)))
    return interpolate(start, goal, np.arange(1, count + 1) / count)


def _through(arm: Arm, joints: Floats, poses: Floats, turns: Floats) -> Floats:
    """Lines of joint points (M, K + 1, dof) through poses (K, 4, 4); in each the last joint turns evenly."""
    count = len(poses)
    share = np.arange(1, count + 1) / count
    turns = turns if arm.robot.spare else turns[:1]
    # Postures are (M, K, branches, dof).
    found = arm.postures(poses, joints[-1] + turns[:, None] * share)
    rows = np.arange(len(turns))
    lines = np.empty((len(turns), count + 1, len(joints)))
    lines[:, 0] = joints
    for k in range(count):
        away = np.abs(found[:, k] - lines[:, k, None]).max(axis=-1)
        lines[:, k + 1] = found[rows, k, _or_infinite(away).argmin(axis=1)]
    smooth = (np.abs(np.diff(lines, axis=1)) <= JUMP_RAD).all(axis=(1, 2))  # False for NaN
    return lines[smooth]


class Arrivals:
    """Postures of an arm at goals (G, 4, 4), each reached through its pose in `above`, and on to `rest`."""

    def __init__(self, arm: Arm, above: Floats, goals: Floats, rest: Points | None = None) -> None:
        self._high, low = (  # the angle at which the arm faces the goal is among those tried
            arm.postures(poses[:, None], _turns(arm, poses, every=2)) for poses in (above, goals)
        )
        # An upright shoulder may be passed on the way down.
        self._low = np.stack([low, arm.crossed(low)])
        self._arm = arm
        self._down = _cost(arm, self._high, self._low)
        if rest is not None:
            self._down = 2 * self._down + _cost(arm, self._high, rest)

    def nearest(self, joints: Floats) -> Floats:
        """(G, 3, dof) joints now, above each goal and at it, with least motion; NaN where out of reach."""
        cost = np.moveaxis(_cost(self._arm, joints, self._high) + self._down, 1, 0)  # (G, 2, R, branches)
        goals = np.arange(len(cost))
        way, *index = np.unravel_index(cost.reshape(len(cost), -1).argmin(axis=1), cost.shape[1:])
        found = _corners(joints, self._high[goals, *index], self._low[way, goals, *index])
        found[np.isinf(cost.reshape(len(cost), -1).min(axis=1))] = np.nan
        return found


def _dislike_s(arm: Arm, begin: Floats, end: Floats) -> Floats:
    """(...) s, penalty of a motion between joints (..., dof), also for an elbow out of the upright plane."""
    return EASE * np.abs(end - begin).sum(axis=-1) + UPRIGHT * arm.aside_rad(end)


def _turns(arm: Arm, goals: Floats, every: int = 1) -> Floats:
    """Angles (G, R) rad of the last joint to try for goals (G, 4, 4); R is 1 without redundancy."""
    away_rad = AWAY_RAD[every - 1 :: every] if arm.robot.spare else np.zeros(1)
    return wrapped_rad(arm.facing(goals)[:, None] + away_rad)


def _cost(arm: Arm, a: Floats, b: Floats) -> Floats:
    """(...) the effort between postures (..., dof); infinite where one of them is NaN."""
    moved = np.abs(b - a)
    aside = UPRIGHT * arm.aside_rad(b)
    return _or_infinite(moved.max(axis=-1) + EASE * moved.sum(axis=-1) + aside)


def _corners(*postures: Floats) -> Floats:
    """(..., K, dof) of K postures (..., dof)."""
    return np.stack(np.broadcast_arrays(*postures), axis=-2)


def _or_infinite(values: Floats) -> Floats:
    """Replaces NaN by infinity; np.nan_to_num takes several times as long."""
    return np.where(np.isnan(values), np.inf, values)
