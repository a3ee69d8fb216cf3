"""Disturbed motion: demonstrations that show how to come back (DART, Laskey et al. 2017).

The arms are sent along their paths with smooth bumps added, while what they should have done stays what
is learned: a policy that strays sees states like these, and what leads back from them. Bumps are added to
positions of the path, not to moments, so that the disturbed motion is a trajectory like any other, which
the same schedule runs and the same checks judge.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.robots import limits_rad
from rf_exp.types import ARM_JOINTS, Segment, Trajectory

BUMP_STEPS = (10, 25)  # how long a bump lasts, shortest and longest
GAP_STEPS = 10  # between two bumps, at most
CALM_STEPS, FADE_STEPS = 4, 16  # before and after the fingers move: undisturbed, then ever more
CARRYING, TOGETHER = 0.4, 0.2  # part of the strength while something is held, and held by several
TOUCHING = ("press", "strike")  # primitives that end in contact


def disturb(
    trajectories: Sequence[Trajectory],
    strength_rad: float,
    rng: np.random.Generator,
    calm: Mapping[int, Collection[int]] | None = None,
) -> tuple[Trajectory, ...]:
    """The trajectories with bumps on all joints, of standard deviation `strength_rad` at their tops.

    Ends of the trajectories, moments at which fingers open and close, and contacts stay as they are, and so
    do the path positions that `calm` names for an agent; around all of these bumps are smaller.
    """
    return tuple(
        _disturbed(trajectory, strength_rad, rng, (calm or {}).get(trajectory.agent, ()))
        for trajectory in trajectories
    )


def _disturbed(
    trajectory: Trajectory, strength_rad: float, rng: np.random.Generator, calm: Collection[int]
) -> Trajectory:
    share = _share(trajectory, calm)
    offsets = strength_rad * _bumps(len(trajectory), rng) * share[:, None]  # (P, 7), positions from 1 on
    low, high = limits_rad()
    segments: list[Segment] = []
    for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
        qpos = segment.qpos + offsets[end - len(segment) : end]
        segments.append(replace(segment, qpos=np.clip(qpos, low, high)))
    return replace(trajectory, segments=tuple(segments))


def _bumps(steps: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(steps, 7) smooth bumps of unit standard deviation at their tops, one after the other."""
    found = np.zeros((steps, ARM_JOINTS))
    at = int(rng.integers(0, GAP_STEPS + 1))
    while at < steps:
        length = int(rng.integers(BUMP_STEPS[0], BUMP_STEPS[1] + 1))
        shape = np.sin(np.pi * (np.arange(length) + 1) / (length + 1)) ** 2
        bump = shape[:, None] * rng.normal(size=ARM_JOINTS)
        found[at : at + length] += bump[: steps - at]
        at += length + int(rng.integers(0, GAP_STEPS + 1))
    return found


def _share(trajectory: Trajectory, calm_at: Collection[int]) -> NDArray[np.float64]:
    """(P,) which part of the strength each position of a path gets."""
    steps = len(trajectory)
    part, calm = np.ones(steps), np.zeros(steps, dtype=bool)
    calm[[position - 1 for position in calm_at if position > 0]] = True
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
