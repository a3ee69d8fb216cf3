"""Postures and straight lines of one arm: candidates, and the one that takes the least time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rf_exp.datagen.motion.state import Floats, Points
from rf_exp.datagen.motion.timing import duration_s
from rf_exp.robots import Arm
from rf_exp.transforms import Matrix, interpolate, wrap_rad
from rf_exp.types import JointLimits

LINE_STEP_M = 0.01  # between the poses of a straight line for which inverse kinematics is solved
LAST_JOINT_OFFSETS_RAD = np.arange(-15, 16) * (2 * np.pi / 31)  # from where the arm faces the goal
FINE_OFFSETS_RAD = np.arange(-4, 5) * 0.04  # about the best of LAST_JOINT_OFFSETS_RAD
APPROACH_TURN_STEPS = (-2, -1, 0, 1, 2)  # offsets by which the last joint may turn along an approach
MIN_STEPS_APART = 2  # offsets between postures that are worth trying one after the other
POSTURES_PER_GOAL = 4
LINE_TURNS_RAD = np.array([0, *(sign * turn for turn in (0.05, 0.1, 0.2, 0.4, 0.7) for sign in (1, -1))])
MAX_JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch
JOINT_MOTION_COST = 0.01  # s/rad, cost of the motion of all joints, added to its duration
ELBOW_COST = 0.03  # s/rad, cost of the elbow's angle out of the upright plane, where it is in others' way


@dataclass(frozen=True)
class Approach:
    """Straight approach to a goal; estimated from its two ends until it is `exact`."""

    goal: int  # index of the goal
    duration_s: float  # duration of the motion to its beginning, and along it
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
        arm, both = self.arm, (self.pregrasps, self.goals)
        starts, ends = (arm.postures(poses[:, None], _last_joint_angles(arm, poses)) for poses in both)
        opposite = arm.permuted_to_opposite(ends)
        ends_by_turn = np.stack(
            [np.roll(each, k, axis=1) for each in (ends, opposite) for k in APPROACH_TURN_STEPS]
        )
        choice = _effort(arm, starts, ends_by_turn).argmin(axis=0)
        nearest = np.take_along_axis(ends_by_turn, choice[None, ..., None], axis=0)[0]
        durations_s = self._durations_s(starts, nearest)
        cost = durations_s + self._penalty_s(starts, nearest)
        if rest is not None:
            cost += departure_s(starts, nearest, rest, self.limits)
        cost = _or_infinite(cost)
        chosen: list[tuple[int, int, int]] = []
        for flat in np.argsort(cost, axis=None, kind="stable"):
            goal, turn, branch = map(int, np.unravel_index(flat, cost.shape))
            index = goal, turn, branch
            if not np.isfinite(cost[index]):
                return
            of_goal = [each for each in chosen if each[0] == goal]
            is_similar = any(b == branch and abs(t - turn) < MIN_STEPS_APART for _, t, b in of_goal)
            if is_similar or len(of_goal) == POSTURES_PER_GOAL:
                continue
            chosen.append(index)
            points = np.stack([starts[index], nearest[index]])
            yield Approach(goal, float(durations_s[index]), points, branch)

    def exact(self, estimate: Approach) -> Approach | None:
        """The approach with all its points (K, dof), or None where there is no such line."""
        goal = self.goals[estimate.goal]
        for begin, end in (self._refined_ends(estimate), estimate.points):
            turns = np.append(LINE_TURNS_RAD, end[-1] - begin[-1])
            lines = _lines_through(self.arm, begin, _line_poses(self.arm, begin, goal), turns)
            if len(lines):
                durations_s = self._durations_s(begin, lines[:, lines.shape[1] // 2], lines[:, -1])
                best = int((durations_s + self._penalty_s(begin, lines[:, -1])).argmin())
                return replace(estimate, duration_s=float(durations_s[best]), points=lines[best], exact=True)
        return None

    def _refined_ends(self, estimate: Approach) -> Points:
        """Ends (2, dof) of nearly the same approach that are reached sooner, if there are any."""
        goal, branch = estimate.goal, estimate.branch
        begin, end = estimate.points
        starts = self.arm.postures(self.pregrasps[goal], begin[-1] + FINE_OFFSETS_RAD)[:, branch, None]
        ends = self.arm.postures(self.goals[goal], end[-1] + FINE_OFFSETS_RAD)
        ends = ends[:, [branch, self.arm.branch_beyond_singularity(branch)]].reshape(-1, ends.shape[-1])
        cost = _or_infinite(self._durations_s(starts, ends) + self._penalty_s(starts, ends))
        if not np.isfinite(cost).any():
            return estimate.points
        i, j = np.unravel_index(cost.argmin(), cost.shape)
        return np.stack([starts[i, 0], ends[j]])

    def _durations_s(self, *after: Floats) -> Floats:
        """(...) s of going through postures (..., dof) in turn."""
        return duration_s(_stacked(*self.before, *after), self.limits)

    def _penalty_s(self, begin: Floats, end: Floats) -> Floats:
        """(...) s, penalty of an approach for joint motion, and for an elbow out of the upright plane."""
        return _penalty_s(self.arm, self.before[-1], begin) + _penalty_s(self.arm, begin, end)


def departure_s(high: Floats, low: Floats, rest: Points, limits: JointLimits) -> Floats:
    """(...) s from postures `low` back up to `high` (..., dof), where an arm stops, and on to `rest`."""
    return duration_s(_stacked(low, high), limits) + duration_s(_stacked(high, rest), limits)


def straight_line(arm: Arm, joints: Floats, goal: Matrix, limits: JointLimits) -> Points | None:
    """Joint points (K, dof) of the fastest straight TCP line from joints (dof,) to a pose, or None."""
    return path_through(arm, joints, _line_poses(arm, joints, goal), limits)


def path_through(arm: Arm, joints: Floats, poses: Floats, limits: JointLimits) -> Points | None:
    """Joint points (K + 1, dof) of the fastest motion from joints (dof,) through TCP poses (K, 4, 4)."""
    turns = np.append(LINE_TURNS_RAD, arm.preferred_last_rad(poses[-1]) - joints[-1])
    lines = _lines_through(arm, joints, poses, turns)
    if not len(lines):
        return None
    middle, end = lines[:, lines.shape[1] // 2], lines[:, -1]
    durations_s = duration_s(_stacked(joints, middle, end), limits)
    return lines[(durations_s + _penalty_s(arm, joints, end)).argmin()]


def _line_poses(arm: Arm, joints: Floats, goal: Matrix) -> Floats:
    """(K, 4, 4) TCP poses on the straight line from joints (dof,) to a pose, which comes last."""
    start = arm.tcp(joints)
    count = max(1, int(np.ceil(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / LINE_STEP_M - 1e-6)))
    return interpolate(start, goal, np.arange(1, count + 1) / count)


def _lines_through(arm: Arm, joints: Floats, poses: Floats, turns: Floats) -> Floats:
    """Lines of joint points (M, K + 1, dof) through poses (K, 4, 4); in each the last joint turns evenly."""
    count = len(poses)
    share = np.arange(1, count + 1) / count
    turns = turns if arm.robot.is_redundant else turns[:1]
    # Postures are (M, K, branches, dof).
    postures = arm.postures(poses, joints[-1] + turns[:, None] * share)
    rows = np.arange(len(turns))
    lines = np.empty((len(turns), count + 1, len(joints)))
    lines[:, 0] = joints
    for k in range(count):
        distances = np.abs(postures[:, k] - lines[:, k, None]).max(axis=-1)
        lines[:, k + 1] = postures[rows, k, _or_infinite(distances).argmin(axis=1)]
    smooth = (np.abs(np.diff(lines, axis=1)) <= MAX_JUMP_RAD).all(axis=(1, 2))  # False for NaN
    return lines[smooth]


class Arrivals:
    """Postures of an arm at goals (G, 4, 4), each reached through its pose in `above`, and on to `rest`."""

    def __init__(self, arm: Arm, above: Floats, goals: Floats, rest: Points | None = None) -> None:
        self._above_goals, at_goals = (  # the angle at which the arm faces the goal is among those tried
            arm.postures(poses[:, None], _last_joint_angles(arm, poses, every=2)) for poses in (above, goals)
        )
        # An upright shoulder may be passed on the way down.
        self._at_goals = np.stack([at_goals, arm.permuted_to_opposite(at_goals)])
        self._arm = arm
        self._costs = _effort(arm, self._above_goals, self._at_goals)
        if rest is not None:
            self._costs = 2 * self._costs + _effort(arm, self._above_goals, rest)

    def nearest(self, joints: Floats) -> Floats:
        """(G, 3, dof) joints now, above each goal and at it, with least motion; NaN where out of reach."""
        costs = _effort(self._arm, joints, self._above_goals) + self._costs
        costs = np.moveaxis(costs, 1, 0)  # (G, 2, R, branches)
        goals = np.arange(len(costs))
        crossed, *index = np.unravel_index(costs.reshape(len(costs), -1).argmin(axis=1), costs.shape[1:])
        corners = _stacked(joints, self._above_goals[goals, *index], self._at_goals[crossed, goals, *index])
        corners[np.isinf(costs.reshape(len(costs), -1).min(axis=1))] = np.nan
        return corners


def _penalty_s(arm: Arm, begin: Floats, end: Floats) -> Floats:
    """(...) s, penalty of a motion between joints (..., dof), also for an elbow out of the upright plane."""
    return JOINT_MOTION_COST * np.abs(end - begin).sum(axis=-1) + ELBOW_COST * arm.elbow_angle_rad(end)


def _last_joint_angles(arm: Arm, goals: Floats, every: int = 1) -> Floats:
    """Angles (G, R) rad of the last joint to try for goals (G, 4, 4); R is 1 without redundancy."""
    offsets_rad = LAST_JOINT_OFFSETS_RAD[every - 1 :: every] if arm.robot.is_redundant else np.zeros(1)
    return wrap_rad(arm.preferred_last_rad(goals)[:, None] + offsets_rad)


def _effort(arm: Arm, a: Floats, b: Floats) -> Floats:
    """(...) the effort between postures (..., dof); infinite where one of them is NaN."""
    moved = np.abs(b - a)
    aside = ELBOW_COST * arm.elbow_angle_rad(b)
    return _or_infinite(moved.max(axis=-1) + JOINT_MOTION_COST * moved.sum(axis=-1) + aside)


def _stacked(*postures: Floats) -> Floats:
    """(..., K, dof) of K postures (..., dof)."""
    return np.stack(np.broadcast_arrays(*postures), axis=-2)


def _or_infinite(values: Floats) -> Floats:
    """Replaces NaN by infinity; np.nan_to_num takes several times as long."""
    return np.where(np.isnan(values), np.inf, values)
