"""Speed limit of a gripper: its path is limit_speeds down, and checked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, OneAgentCheck
from rf_exp.constraints.plan import Plan, resampled
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.findings import CheckName, Finding, agent_name
from rf_exp.robots import Arm
from rf_exp.statements import SpeedLimit
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, Segment, Trajectory

MEASUREMENT_FACTOR = 1.25  # factor on the bound: an arm that catches up with its command is faster
DURATION_FACTOR = (
    1.02  # factor on the duration: straight lines in joint space are not straight for the gripper
)


@dataclass(frozen=True)
class SpeedLimitCheck(OneAgentCheck, BoundedCheck):
    """The gripper of an agent keeps a speed limit. Value and bound in m/s.

    Paths are limit_speeds down to it (`limit_speeds`) before scheduling, so it has no rule for timing.
    """

    statement_type, name, unit = SpeedLimit, CheckName.SCHEDULING, "m/s"
    finding, rounding = Finding.TOO_FAST, 1 + 1e-9

    at_most_m_s: float
    text: str = ""

    def __repr__(self) -> str:
        return f"VS({agent_name(self.agent)}, at most {self.at_most_m_s:g} m/s)"

    @property
    def bounds(self) -> tuple[float, float]:
        return self.at_most_m_s, self.at_most_m_s * MEASUREMENT_FACTOR

    def planned(self, plan: Plan) -> Evidence:
        speeds = speeds_m_s(plan.task.arms[self.agent], plan.trajectory(self.agent).path())
        if not len(speeds):
            return self.not_applicable(plan, self.at_most_m_s)
        fastest = self.worst(speeds)
        activities = plan.doing(self.agents, [fastest + 1])
        return self.evidence_for(speeds[fastest], plan.time_s(self.agent, fastest + 1), doing=activities)

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        qpos, qvel = scene.qpos[self.agent - 1], scene.qvel[self.agent - 1]
        path = np.stack([qpos, qpos + qvel * CONTROL_DT_S])
        speed = speeds_m_s(plan.task.arms[self.agent], path)[0]
        return self.evidence_for(speed, scene.time_s, measured=True)

    def stl(self, task: Task) -> Specification:
        description = (
            f"of the gripper of {agent_name(self.agent)}, by measured joint positions and velocities"
        )
        return self.formula(identifier("speed", self.agent), description)


def speeds_m_s(arm: Arm, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P - 1,) of the tool centre point between path positions (P, dof or more) a control step apart."""
    return np.linalg.norm(np.diff(arm.tcp(path)[:, :3, 3], axis=0), axis=1) / CONTROL_DT_S


def limit_speeds(
    trajectories: Sequence[Trajectory], arms: Sequence[Arm], limits_m_s: Mapping[int, float]
) -> tuple[Trajectory, ...]:
    """The same paths, with segments stretched so that the gripper of each agent keeps its speed limit.

    Joined segments are stretched equally. Without limits the trajectories are returned unchanged.
    """
    if not limits_m_s:
        return tuple(trajectories)
    limits = {trajectory.agent: limits_m_s.get(trajectory.agent, np.inf) for trajectory in trajectories}
    factors = [
        _factors(trajectory, arms[trajectory.agent - 1], limits[trajectory.agent])
        for trajectory in trajectories
    ]
    joined_factors: dict[str | None, float] = {}
    for trajectory, segment_factors in zip(trajectories, factors, strict=True):
        for segment, factor in zip(trajectory.segments, segment_factors, strict=True):
            joined_factors[segment.joined] = max(factor, joined_factors.get(segment.joined, 1.0))
    slowed_trajectories = []
    for trajectory, segment_factors in zip(trajectories, factors, strict=True):
        segments, path = [], trajectory.path()
        for (segment, start, end), factor in zip(trajectory.intervals, segment_factors, strict=True):
            joint_factor = factor if segment.joined is None else joined_factors[segment.joined]
            segments.append(_stretched(segment, path[start : end + 1], joint_factor))
        slowed_trajectories.append(replace(trajectory, segments=tuple(segments)))
    return tuple(slowed_trajectories)


def _factors(trajectory: Trajectory, arm: Arm, limit_m_s: float) -> list[float]:
    """Factors on the durations of the segments."""
    path, factors = trajectory.path(), []
    for _, start, end in trajectory.intervals:
        fastest = float(speeds_m_s(arm, path[start : end + 1]).max())
        factors.append(fastest / limit_m_s * DURATION_FACTOR if fastest > limit_m_s else 1.0)
    return factors


def _stretched(segment: Segment, path: NDArray[np.float64], factor: float) -> Segment:
    """A segment with `factor` times its steps, linearly interpolated between the positions of its path."""
    if factor <= 1.0:
        return segment
    steps = int(np.ceil(len(segment) * factor))
    positions = np.arange(1, steps + 1) * len(segment) / steps
    commands = segment.gripper[np.ceil(positions - 1e-9).astype(int) - 1]  # not interpolated
    return replace(resampled(segment, path, positions), gripper=commands)
