"""What a check looks at, and what it answers with."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.clearance import Mask, Swept, closer_than
from rf_exp.constraints.seen import Seen, together
from rf_exp.constraints.world import AGENT_MARGIN_M, OBJECT_MARGIN_M, Bodies
from rf_exp.statements import agent_name
from rf_exp.tasks import Task
from rf_exp.types import (
    ARM_JOINTS,
    CONTROL_DT_S,
    Cause,
    Kind,
    Row,
    Scene,
    Schedule,
    Segment,
    Trajectory,
    Violation,
)

CAUSES: Mapping[Kind, Cause] = {"logical": "interaction", "temporal": "time", "spatial": "space"}
FINER = 8  # steps of the second look in one control step


@dataclass(frozen=True)
class Evidence:
    """The answer of a check: never a bare bool."""

    ok: bool
    value: float  # what was found, in the unit of the check
    bound: float  # what is allowed
    reason: str  # a sentence that a person and a model can act on
    time_s: float = 0.0  # since the start of the episode
    agents: tuple[int, ...] = ()  # those it is about, where these are not all agents of the check


class Check(Protocol):
    """One compiled constraint. Every implementation is a small frozen class."""

    kind: ClassVar[Kind]
    name: ClassVar[str]  # of the paper's validation function
    unit: ClassVar[str]  # of value and bound; empty for a share

    @property
    def agents(self) -> tuple[int, ...]: ...

    @property
    def text(self) -> str:
        """The constraint as it was stated."""
        ...

    def planned(self, plan: "Plan") -> Evidence:
        """Judge trajectories and schedule before anything moves."""
        ...

    def measured(self, scene: Scene, plan: "Plan") -> Evidence | None:
        """Judge the real state at one control step; None when there is nothing to judge now."""
        ...


def violation(check: Check, evidence: Evidence) -> Violation:
    """The failed check as feedback."""
    return Violation(
        check.name,
        CAUSES[check.kind],
        evidence.agents or check.agents,
        evidence.time_s,
        evidence.value,
        evidence.bound,
        evidence.reason,
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """What is about to be executed, from `scene` on; the frame of every check."""

    task: Task
    row: Row
    scene: Scene
    trajectories: tuple[Trajectory, ...]  # one an agent, in the order of the agents
    schedule: Schedule | None = None

    @cached_property
    def bodies(self) -> Bodies:
        return Bodies(self.task, self.scene, self.trajectories)

    @cached_property
    def swept(self) -> tuple[Swept, ...]:
        """Every agent along its trajectory with what it moves."""
        return tuple(self.bodies.along(trajectory) for trajectory in self.trajectories)

    @cached_property
    def diagrams(self) -> Mapping[tuple[int, int], Mask]:
        """Coordination diagrams (P_i, P_j) of all pairs of agents i < j: True = too close."""
        agents = self.task.agents
        return {
            (i, j): closer_than(self.swept[i - 1], self.swept[j - 1], AGENT_MARGIN_M)
            for i in agents
            for j in agents
            if i < j
        }

    @cached_property
    def still(self) -> tuple[Swept, ...]:
        """For each agent what nobody moves: the objects, or as far as cameras have looked what they see."""
        if self.scene.seen is None:
            return (self.bodies.standing(),) * len(self.trajectories)
        seen, moved, found = Seen(self.bodies), self.bodies.moved, []
        for trajectory in self.trajectories:
            about = {name for segment in trajectory.segments for name in segment.about}
            about &= set(self.task.objects)
            boxes, exactly = seen.obstacles(trajectory.agent, about | moved)
            found.append(together(self.bodies.standing(sorted(exactly - moved)), boxes))
        return tuple(found)

    @cached_property
    def blocked(self) -> tuple[Mask, ...]:
        """(P,) for each agent: too close to something that nobody moves, or in the table.

        Between two positions a fast arm may move further than a gap is wide, so what the bound on the
        motion flags gets a second look at a path of finer steps.
        """
        found = []
        for trajectory, body, still in zip(self.trajectories, self.swept, self.still, strict=True):
            near = closer_than(body, still, OBJECT_MARGIN_M)[:, 0]
            if near.any():
                close = closer_than(self.finer(trajectory.agent), still, OBJECT_MARGIN_M)[:, 0]
                near = np.array([close[self.around(at)].any() for at in range(len(near))])
            found.append(near | self.bodies.below_table(body))
        return tuple(found)

    def finer(self, agent: int) -> Swept:
        """An agent along its trajectory with FINER positions for each one."""
        return self.bodies.along(_finer(self.trajectory(agent)))

    @staticmethod
    def around(position: int) -> slice:
        """The finer positions that are nearest to a path position."""
        return slice(max(0, FINER * position - FINER // 2), FINER * position + FINER // 2 + 1)

    def trajectory(self, agent: int) -> Trajectory:
        return self.trajectories[agent - 1]

    def positions(self, agent: int) -> NDArray[np.int64]:
        """(T + 1,) path position of an agent at each control step; without a schedule its own pace."""
        if self.schedule is None:
            return np.arange(len(self.trajectory(agent)) + 1)
        return self.schedule.positions[:, agent - 1]

    def position_now(self, agent: int, scene: Scene) -> int:
        """Path position that the agent was sent to in the step before this scene was measured."""
        positions = self.positions(agent)
        return int(positions[np.clip(scene.step - self.scene.step, 0, len(positions) - 1)])

    @property
    def begins_s(self) -> float:
        """When the plan begins, on the clock of the episode."""
        return self.scene.step * CONTROL_DT_S

    def time_s(self, agent: int, position: int) -> float:
        """When an agent first is at a path position, on the clock of the episode."""
        return self.begins_s + float(np.searchsorted(self.positions(agent), position)) * CONTROL_DT_S

    def segment_at(self, agent: int, position: int) -> Segment | None:
        """The segment that ends at or after a path position; None without segments."""
        trajectory = self.trajectory(agent)
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            if position <= end:
                return segment
        return trajectory.segments[-1] if trajectory.segments else None


def _finer(trajectory: Trajectory) -> Trajectory:
    """The same motion with FINER path positions for each one, straight in joints and gripper."""
    path, start = trajectory.path(), 0
    segments = []
    for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
        at = np.arange(FINER * start + 1, FINER * end + 1) / FINER
        finer = np.column_stack([np.interp(at, np.arange(len(path)), column) for column in path.T])
        segments.append(replace(segment, qpos=finer[:, :ARM_JOINTS], gripper=finer[:, ARM_JOINTS]))
        start = end
    return replace(trajectory, segments=tuple(segments))


def names(agents: tuple[int, ...]) -> str:
    """`Agent_1` or `[Agent_1, Agent_2]`, as the paper prints check code."""
    listed = ", ".join(agent_name(agent) for agent in agents)
    return listed if len(agents) == 1 else f"[{listed}]"


def doing(segment: Segment | None) -> str:
    """What an agent is about in a segment, in words."""
    return "standing still" if segment is None else f"to {segment.subgoal.text} ({segment.primitive})"
