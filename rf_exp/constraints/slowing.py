"""Paths that are made so slow that grippers keep to their speed limits."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.robots import Arm
from rf_exp.types import CONTROL_DT_S, Segment, Trajectory, arm_of, gripper_of

SPARE = 1.02  # straight lines between positions in joint space are none of the gripper


def speeds_m_s(arm: Arm, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P - 1,) of the tool centre point between path positions (P, dof or more) a control step apart."""
    return np.linalg.norm(np.diff(arm.tcp(path)[:, :3, 3], axis=0), axis=1) / CONTROL_DT_S


def slowed(
    trajectories: Sequence[Trajectory], arms: Sequence[Arm], limits_m_s: Mapping[int, float]
) -> tuple[Trajectory, ...]:
    """The same paths, with every segment of an agent so slow that its gripper keeps to the agent's limit.

    Segments that several agents make together stay together. Without limits they are returned as they are.
    """
    if not limits_m_s:
        return tuple(trajectories)
    factors = {  # (agent, index of the segment) -> how much longer it takes
        (trajectory.agent, index): factor
        for trajectory in trajectories
        for index, factor in enumerate(_factors(trajectory, arms, limits_m_s.get(trajectory.agent, np.inf)))
    }
    joined: dict[str, float] = {}
    for trajectory in trajectories:
        for index, segment in enumerate(trajectory.segments):
            if segment.joined is not None:
                factor = factors[trajectory.agent, index]
                joined[segment.joined] = max(factor, joined.get(segment.joined, 1.0))
    found = []
    for trajectory in trajectories:
        segments, last = [], trajectory.path()[0]
        for index, segment in enumerate(trajectory.segments):
            factor = joined.get(segment.joined or "", factors[trajectory.agent, index])
            segments.append(_stretched(segment, last, factor))
            last = np.append(segment.qpos[-1], segment.gripper[-1])
        found.append(replace(trajectory, segments=tuple(segments)))
    return tuple(found)


def _factors(trajectory: Trajectory, arms: Sequence[Arm], limit_m_s: float) -> list[float]:
    path, factors = trajectory.path(), []
    for _, start, end in trajectory.intervals:
        speeds = speeds_m_s(arms[trajectory.agent - 1], path[start : end + 1])
        fastest = float(speeds.max())
        factors.append(fastest / limit_m_s * SPARE if fastest > limit_m_s else 1.0)
    return factors


def _stretched(segment: Segment, before: NDArray[np.float64], factor: float) -> Segment:
    """A segment on a grid of so many times its steps, straight between its positions."""
    if factor <= 1.0:
        return segment
    path = np.vstack([before, np.column_stack([segment.qpos, segment.gripper])])
    steps = int(np.ceil(len(segment) * factor))
    at = np.arange(1, steps + 1) * len(segment) / steps
    rows = np.column_stack([np.interp(at, np.arange(len(path)), column) for column in path.T])
    rows[:, -1] = segment.gripper[np.ceil(at - 1e-9).astype(int) - 1]  # commands do not blend
    return replace(segment, qpos=arm_of(rows), gripper=gripper_of(rows))
