"""Postures and straight lines of one arm: which there are, and which takes the least motion."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial, reduce

import numpy as np
from numpy.typing import NDArray

from rf_exp.robots import OTHER_SIGN, Panda, crossed
from rf_exp.transforms import Matrix, interpolate, wrapped_rad

LINE_STEP_M = 0.01  # between the poses of a straight line for which postures are found
AWAY_RAD = np.arange(-15, 16) * (2 * np.pi / 31)  # of the last joint, from where the arm faces the goal
FINE_RAD = np.arange(-4, 5) * 0.04  # about the best of them
NEXT = (-2, -1, 0, 1, 2)  # steps that it may turn along an approach
APART = 2  # steps of the last joint between postures that are worth trying one after the other
TRIES = 4  # postures for each goal
TURNS_RAD = np.array([0, *(sign * turn for turn in (0.05, 0.1, 0.2, 0.4, 0.7) for sign in (1, -1))])
JUMP_RAD = 0.35  # between neighbouring points of a straight line: more is a change of branch
EASE = 0.03  # weight of the motion of all joints beside that of the one that moves most, which takes the time
REVERSAL = 2.0  # weight of what a joint goes back again on an approach: it stops where it turns round
UPRIGHT = 0.05  # weight of the angle by which the elbow leaves the upright plane, where it is in others' way
_SWIVEL = 2  # the joint that does it

Points = NDArray[np.float64]  # (K, 7) rad


@dataclass(frozen=True)
class Approach:
    """A straight motion to a goal."""

    goal: int  # its number among those that were asked for
    effort_rad: float  # of going to where it begins, and along it
    least_rad: float  # the same, and from where it begins on to rest, if the arm goes there afterwards
    points: Points


def effort_rad(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) cost of joint paths (..., K, 7): time, but for starting and stopping; a little for each joint."""
    moved = np.abs(np.diff(points, axis=-2))
    longest, altogether = moved.max(axis=-1).sum(axis=-1), moved.reshape(*moved.shape[:-2], -1).sum(axis=-1)
    return longest + EASE * altogether + UPRIGHT * np.abs(points[..., -1, _SWIVEL])


def approaches(
    arm: Panda,
    pregrasps: NDArray[np.float64],
    goals: NDArray[np.float64],
    start: NDArray[np.float64],
    rest: NDArray[np.float64] | None = None,
) -> Iterator[Approach]:
    """Straight motions from pre-grasp poses (G, 4, 4) to `goals`; the cheapest from `start` (7,) rad first.

    Of what is put down or struck, the pre-grasp pose is the one above the place. With `rest` (7,) rad, from
    there on to rest is counted too.

    The arm has a joint to spare, so one pose has many postures; some lead through stretched arms, where a
    short line takes long.
    """
    turns = _turns(arm, goals)  # (G, R)
    first, last = (arm.postures(poses[:, None], turns) for poses in (pregrasps, goals))  # (G, R, branches, 7)
    begun = partial(_begun, start, rest)
    ends = [np.roll(each, k, axis=1) for each in (last, crossed(last)) for k in NEXT]
    on = reduce(np.minimum, (_cost(first, each) for each in ends))
    cost = begun(first) + on + REVERSAL * reduce(np.fmin, (_back_again(start, first, each) for each in ends))
    taken: list[tuple[int, int, int]] = []
    for flat in np.argsort(cost, axis=None, kind="stable"):
        goal, turn, branch = (int(index) for index in np.unravel_index(flat, cost.shape))
        if not np.isfinite(cost[goal, turn, branch]):
            return
        of_goal = [each for each in taken if each[0] == goal]
        near = any(b == branch and abs(t - turn) < APART for _, t, b in of_goal)
        if near or len(of_goal) == TRIES:
            continue
        taken.append((goal, turn, branch))
        fine = turns[goal, turn] + FINE_RAD
        postures = arm.postures(pregrasps[goal], fine)[:, branch]
        along = [_cost(postures, last[goal, turn, each]) for each in (branch, OTHER_SIGN[branch])]
        begin = postures[np.argmin(begun(postures) + np.min(along, axis=0))]
        if not np.isfinite(begin).all():
            begin = first[goal, turn, branch]
        points = straight(arm, begin, goals[goal])
        if points is not None:
            more = effort_rad(points) + REVERSAL * _back_again(start, begin, points[-1])
            effort, least = (round(float(each + more), 6) for each in (_cost(start, begin), begun(begin)))
            yield Approach(goal, effort, least, points)


def straight(arm: Panda, joints: NDArray[np.float64], goal: Matrix) -> Points | None:
    """Joint points (K, 7) of the straight line of the TCP from joints (7,) to a pose, or None.

    The last joint turns evenly, by what makes the line shortest.
    """
    poses = _poses(arm.tcp(joints), goal)
    share = np.arange(1, len(poses) + 1) / len(poses)
    turns = np.append(TURNS_RAD, arm.facing(goal) - joints[-1])
    found = arm.postures(poses, joints[-1] + turns[:, None] * share)  # (M, K, branches, 7)
    rows = np.arange(len(turns))
    lines = np.empty((len(turns), len(poses) + 1, len(joints)))
    lines[:, 0] = joints
    for k in range(len(poses)):
        away = np.abs(found[:, k] - lines[:, k, None]).max(axis=-1)
        lines[:, k + 1] = found[rows, k, _or_infinite(away).argmin(axis=1)]
    smooth = (np.abs(np.diff(lines, axis=1)) <= JUMP_RAD).all(axis=(1, 2))  # what is NaN is not
    if not smooth.any():
        return None
    lines = lines[smooth]
    return lines[effort_rad(lines).argmin()]


class Arrivals:
    """Where an arm may arrive at goals (G, 4, 4), each through its pose in `above` (G, 4, 4).

    With `rest` (7,) rad it goes back up, and on to there.
    """

    def __init__(
        self,
        arm: Panda,
        above: NDArray[np.float64],
        goals: NDArray[np.float64],
        rest: NDArray[np.float64] | None = None,
    ) -> None:
        turns = _turns(arm, goals)[:, 1::2]  # where the arm faces the goal is among them
        self._high, low = (arm.postures(poses[:, None], turns) for poses in (above, goals))
        # An upright shoulder may be passed on the way down.
        self._ways_down = [(each, _cost(self._high, each)) for each in (low, crossed(low))]
        if rest is not None:
            home = _cost(self._high, rest)
            self._ways_down = [(each, 2 * down + home) for each, down in self._ways_down]

    def efforts_rad(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(G,) the least effort from joints (7,) for each goal; infinite where it is out of reach."""
        there = _cost(joints, self._high)
        return np.min([there + down for _, down in self._ways_down], axis=(0, 2, 3))

    def nearest(self, joints: NDArray[np.float64]) -> Points | None:
        """Joints (3, 7) now, above a goal, at it; with the least motion. None where it is out of reach."""
        there = _cost(joints, self._high)
        best: tuple[float, Points] | None = None
        for low, down in self._ways_down:
            cost = there + down
            index = np.unravel_index(np.argmin(cost), cost.shape)
            if np.isfinite(cost[index]) and (best is None or cost[index] < best[0]):
                best = cost[index], np.stack([joints, self._high[index], low[index]])
        return None if best is None else best[1]


def _turns(arm: Panda, goals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (G, R) rad of the last joint that are tried for goals (G, 4, 4)."""
    return wrapped_rad(arm.facing(goals)[:, None] + AWAY_RAD)


def _cost(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) the effort between postures (..., 7); infinite where one of them is NaN."""
    moved = np.abs(b - a)
    aside = UPRIGHT * np.abs(b[..., _SWIVEL])
    return _or_infinite(moved.max(axis=-1) + EASE * moved.sum(axis=-1) + aside)


def _begun(
    start: NDArray[np.float64], rest: NDArray[np.float64] | None, b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(...) the effort from `start` (7,) to postures (..., 7), and from there on to rest, if that counts."""
    return _cost(start, b) if rest is None else _cost(start, b) + _cost(b, rest)


def _back_again(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(...) rad by which the joint that turns round most at `b` goes back on the way from `a` to `c`.

    0 where `c` does not exist, so that a posture with few neighbours is not refused for their sake.
    """
    there, on = b - a, c - b
    back = np.where(there * on < 0, np.minimum(np.abs(there), np.abs(on)), 0.0)
    return back.max(axis=-1)


def _or_infinite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """In place of NaN; np.nan_to_num takes several times as long."""
    return np.where(np.isnan(values), np.inf, values)


def _poses(start: Matrix, goal: Matrix) -> NDArray[np.float64]:
    """Poses (K, 4, 4) of the straight line after its start."""
    count = max(1, int(np.ceil(np.linalg.norm(goal[:3, 3] - start[:3, 3]) / LINE_STEP_M - 1e-6)))
    return interpolate(start, goal, np.arange(1, count + 1) / count)
