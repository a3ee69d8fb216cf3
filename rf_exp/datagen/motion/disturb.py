"""Disturbed motion: demonstrations that show how to come back (DART, Laskey et al. 2017).

The arms are sent along their paths with smooth perturbations added, while what they should have done stays
what is learned: a policy that strays sees states like these, and what leads back from them. Perturbations are
added to positions of the path, not to moments, so that the disturbed motion is a trajectory like any other,
which the same schedule runs and the same checks judge.

What perturbations add is bounded: `TALLEST` standard deviations, and `ADDED` to the velocity and the
acceleration of a joint. Disturbed motion is within the sum of that and the limits of the plan.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rf_exp.robots import Arm
from rf_exp.types import CONTROL_DT_S, JointLimits, Schedule, Segment, Trajectory, arm_of

PERTURBATION_STEPS = (10, 25)  # how long a perturbation lasts, shortest and longest
GAP_STEPS = (2, 8)  # between two perturbations; from two on, none adds to the acceleration of another
TALLEST = 3.0  # standard deviations
# Together with the default limits of a plan less than any joint of the arms can: 2.17 rad/s, 7.5 rad/s2.
ADDED = JointLimits(velocity_rad_s=1.2, acceleration_rad_s2=6.5)
CALM_STEPS, FADE_STEPS = 4, 16  # before and after the fingers move: undisturbed, then ever more
CARRYING, TOGETHER = 0.4, 0.2  # part of the strength while something is held, and held by several
TOUCHING = ("press", "strike")  # primitives that end in contact
PARTS = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25, 0.0)  # of a perturbation; mirrored, it leads away from a thing


class Perturbation(NamedTuple):
    """A smooth motion of all joints away from a path and back."""

    begins: int  # the path position before the first that is moved
    offsets_rad: NDArray[np.float64]  # (L, dof)

    @property
    def ends(self) -> int:
        """The path position behind the last that is moved."""
        return self.begins + len(self.offsets_rad) + 1


@dataclass
class _Kept:
    """What is left of a perturbation: an index of PARTS."""

    perturbation: Perturbation
    part: int = 0

    @property
    def offsets_rad(self) -> NDArray[np.float64]:
        return PARTS[self.part] * self.perturbation.offsets_rad

    @property
    def gone(self) -> bool:
        return PARTS[self.part] == 0


class Disturbance:
    """Perturbations on all joints of the trajectories of a plan, less of them wherever something objects.

    Ends of the trajectories, moments at which fingers open and close, and contacts stay as they are; around
    them, and while something is held, perturbations are smaller.
    """

    def __init__(
        self,
        arms: Mapping[int, Arm],
        trajectories: Sequence[Trajectory],
        schedule: Schedule,
        strength_rad: float,
        rng: np.random.Generator,
    ) -> None:
        """`strength_rad` is the standard deviation at the tops; `schedule` says when arms wait."""
        self._trajectories = tuple(trajectories)
        self._kept: dict[int, list[_Kept]] = {}  # of each agent
        for trajectory in trajectories:
            positions = schedule.positions[:, trajectory.agent - 1]
            limits_rad = arms[trajectory.agent].robot.limits_rad
            perturbations = _perturbations(trajectory, positions, limits_rad, strength_rad, rng)
            self._kept[trajectory.agent] = [_Kept(perturbation) for perturbation in perturbations]

    def trajectories(self) -> tuple[Trajectory, ...]:
        """The trajectories as they are disturbed now."""
        return tuple(map(self._disturbed, self._trajectories))

    def lessen(self, wrong: Collection[tuple[int, int]]) -> bool:
        """Mirrors, makes smaller or leaves out what is added at wrong places: agents, path positions.

        Where no perturbation is at any of them the nearest ones. Whether there were any.
        """
        found = [each for each in (self._nearest(*place) for place in wrong) if each is not None]
        least = min((away for _, away in found), default=0)
        perturbations = {id(kept): kept for kept, away in found if away == 0 or least > 0}
        for kept in perturbations.values():
            kept.part += 1
        return bool(perturbations)

    def _nearest(self, agent: int, position: int) -> tuple[_Kept, int] | None:
        """The perturbation of an agent that is nearest to a path position, and how many steps away it is."""
        left = [each for each in self._kept[agent] if not each.gone]
        away = [
            max(each.perturbation.begins - position, position - each.perturbation.ends, 0) for each in left
        ]
        return min(zip(left, away, strict=True), key=lambda each: each[1], default=None)

    def _disturbed(self, trajectory: Trajectory) -> Trajectory:
        offsets = np.zeros_like(arm_of(trajectory.path()))  # of each path position
        for each in self._kept[trajectory.agent]:
            offsets[each.perturbation.begins + 1 : each.perturbation.ends] = each.offsets_rad
        segments: list[Segment] = []
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            qpos = segment.qpos + offsets[end - len(segment) + 1 : end + 1]
            segments.append(replace(segment, qpos=qpos))
        return replace(trajectory, segments=tuple(segments))


def _perturbations(
    trajectory: Trajectory,
    positions: NDArray[np.int64],
    limits_rad: NDArray[np.float64],
    strength_rad: float,
    rng: np.random.Generator,
) -> list[Perturbation]:
    """Perturbations one after the other, at an agent that is at `positions` (T + 1,) of its path."""
    share, steps, found = _share(trajectory), len(trajectory), list[Perturbation]()
    begins = int(rng.integers(0, GAP_STEPS[1] + 1))
    while begins < steps:
        length = int(rng.integers(PERTURBATION_STEPS[0], PERTURBATION_STEPS[1] + 1))
        tops = strength_rad * np.clip(rng.normal(size=len(trajectory.start_qpos)), -TALLEST, TALLEST)
        shape = np.sin(np.pi * (np.arange(length) + 1) / (length + 1)) ** 2
        part = share[begins : begins + length]
        offsets = shape[: len(part), None] * part[:, None] * tops
        if offsets.any():
            found.append(_bounded(Perturbation(begins, offsets), trajectory, positions, limits_rad))
        begins += length + int(rng.integers(GAP_STEPS[0], GAP_STEPS[1] + 1))
    return found


def _bounded(
    perturbation: Perturbation,
    trajectory: Trajectory,
    positions: NDArray[np.int64],
    limits_rad: NDArray[np.float64],
) -> Perturbation:
    """Less of it where it would add more than `ADDED`, or if mirrored lead beyond a joint stop."""
    path = np.zeros_like(arm_of(trajectory.path()))
    path[perturbation.begins + 1 : perturbation.ends] = perturbation.offsets_rad
    added = np.pad(path[positions], ((1, 1), (0, 0)), mode="edge")  # where an arm waits it stops at once
    velocity = np.diff(added, axis=0) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_DT_S
    fastest, hardest = (np.abs(each).max(axis=0) for each in (velocity, acceleration))
    low, high = limits_rad
    along = arm_of(trajectory.path())[perturbation.begins + 1 : perturbation.ends]
    room = np.maximum(np.minimum(along - low, high - along), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = [ADDED.velocity_rad_s / fastest, ADDED.acceleration_rad_s2 / hardest]
        parts += [np.nanmin(room / np.abs(perturbation.offsets_rad), axis=0)]
    return perturbation._replace(
        offsets_rad=perturbation.offsets_rad * np.minimum(np.nanmin(parts, axis=0), 1.0)
    )


def _share(trajectory: Trajectory) -> NDArray[np.float64]:
    """(P,) which part of the strength each position of a path gets, from the first behind its start on."""
    steps = len(trajectory)
    part, calm = np.ones(steps), np.zeros(steps, dtype=bool)
    for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
        span = slice(end - len(segment), end)
        if segment.joined is not None:
            part[span] = TOGETHER
        elif segment.attached is not None:
            part[span] = CARRYING
        if segment.primitive in ("open", "close"):
            calm[span] = True
        elif segment.primitive in TOUCHING:
            calm[end - 1] = True
    calm[-1:] = True  # what follows begins where the plan ends
    still = np.flatnonzero(calm)
    if not len(still):
        return part
    apart = np.abs(np.arange(steps)[:, None] - still[None, :]).min(axis=1)
    return part * np.clip((apart - CALM_STEPS) / FADE_STEPS, 0.0, 1.0)
