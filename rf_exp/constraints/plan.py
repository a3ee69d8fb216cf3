"""Paths of all agents before execution, and plans: paths with a schedule."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Doing
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    Mask,
    PlanningScene,
    Separation,
    Swept,
    closer_than,
    merged,
)
from rf_exp.perception import OccupancyMap
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import (
    CONTROL_DT_S,
    ConstraintSet,
    Scene,
    Schedule,
    Segment,
    Trajectory,
    arm_of,
    doing,
    gripper_of,
)

MEASUREMENT_TOLERANCE_M = 0.02  # tolerance of a measured gripper position
REFINEMENT = 8  # positions per control step on finer paths


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of all agents from `scene` on, without timing: the input of scheduling."""

    task: Task
    constraint_set: ConstraintSet
    scene: Scene
    trajectories: tuple[Trajectory, ...]  # one per agent, in order

    @cached_property
    def planning_scene(self) -> PlanningScene:
        return PlanningScene(self.task, self.scene, self.trajectories)

    @cached_property
    def swept(self) -> tuple[Swept, ...]:
        """Each agent along its trajectory, with the objects that it moves."""
        return tuple(self.planning_scene.along(trajectory) for trajectory in self.trajectories)

    @cached_property
    def diagrams(self) -> Mapping[tuple[int, int], Mask]:
        """Coordination diagrams (P_i, P_j) of all pairs of agents i < j: True = too close."""
        return {
            (i, j): closer_than(self.swept[i - 1], self.swept[j - 1], AGENT_MARGIN_M)
            for i, j in combinations(self.task.agents, 2)
        }

    @cached_property
    def static_obstacles(self) -> tuple[Swept, ...]:
        """Static obstacles of each agent: the objects, or what cameras see if the scene has voxels."""
        if self.scene.occupied_voxels is None:
            return (self.planning_scene.static_objects(),) * len(self.trajectories)
        perceived, moved, obstacles = OccupancyMap(self.planning_scene), self.planning_scene.moved, []
        for trajectory in self.trajectories:
            involved_names = {name for segment in trajectory.segments for name in segment.involved_names}
            involved_names &= set(self.task.objects)
            boxes, known_objects = perceived.obstacles(trajectory.agent, involved_names | moved)
            obstacles.append(
                merged([self.planning_scene.static_objects(sorted(known_objects - moved)), boxes])
            )
        return tuple(obstacles)

    @cached_property
    def blocked(self) -> tuple[Mask, ...]:
        """(P,) for each agent: too close to a static obstacle, or in the table.

        Between two positions a fast arm may move further than a gap is wide, so positions that the bound
        on the motion flags are checked again on a finer path.
        """
        blocked = []
        for trajectory, body, obstacles in zip(
            self.trajectories, self.swept, self.static_obstacles, strict=True
        ):
            close = closer_than(body, obstacles, OBJECT_MARGIN_M)[:, 0]
            if close.any():
                refined_close = closer_than(self.refined(trajectory.agent), obstacles, OBJECT_MARGIN_M)[:, 0]
                close = np.array(
                    [refined_close[self.refined_slice(position)].any() for position in range(len(close))]
                )
            blocked.append(close | self.planning_scene.below_table(body))
        return tuple(blocked)

    def refined(self, agent: int) -> Swept:
        """An agent along its trajectory, with REFINEMENT positions for each path position."""
        return self.planning_scene.along(_refined(self.trajectory(agent)))

    @staticmethod
    def refined_slice(position: int) -> slice:
        """The finer positions that are nearest to a path position."""
        return slice(
            max(0, REFINEMENT * position - REFINEMENT // 2), REFINEMENT * position + REFINEMENT // 2 + 1
        )

    def trajectory(self, agent: int) -> Trajectory:
        return self.trajectories[agent - 1]

    def gripper_positions_m(self, agent: int) -> NDArray[np.float64]:
        """(P, 3) the tool centre point of an agent at its path positions, world frame."""
        return self.task.arms[agent].tcp(self.trajectory(agent).path())[:, :3, 3]


@dataclass(frozen=True, eq=False)
class Plan:
    """Paths with a schedule: the position of each agent at each control step. Input of every check."""

    paths: Paths
    schedule: Schedule

    @cached_property
    def separation(self) -> Separation:
        """Separation of the arms during execution."""
        return Separation(self.task)

    @property
    def task(self) -> Task:
        return self.paths.task

    @property
    def scene(self) -> Scene:
        return self.paths.scene

    @property
    def trajectories(self) -> tuple[Trajectory, ...]:
        return self.paths.trajectories

    def trajectory(self, agent: int) -> Trajectory:
        return self.paths.trajectory(agent)

    @property
    def planning_scene(self) -> PlanningScene:
        return self.paths.planning_scene

    @property
    def begins_s(self) -> float:
        """Start of the plan, on the clock of the episode."""
        return self.scene.time_s

    def attached_object_poses(self, segment: Segment, rows: slice | int = slice(None)) -> NDArray[np.float64]:
        """(..., 4, 4) world_from_object of a segment's attached object, at all steps (T,) or at `rows`."""
        tcp = self.task.arms[segment.agent].tcp(segment.qpos[rows])
        return self.planning_scene.attached(segment, tcp, rows)

    def tcp(self, agent: int, scene: Scene) -> Matrix:
        """world_from_tcp of an agent as measured."""
        return self.task.arms[agent].tcp(scene.qpos[agent - 1])

    def positions(self, agent: int) -> NDArray[np.int64]:
        """(T + 1,) path position of an agent at each control step."""
        return self.schedule.positions[:, agent - 1]

    def position_now(self, agent: int, scene: Scene) -> int:
        """Path position commanded to the agent in the step before this scene was measured."""
        return int(self.recent_positions(agent, scene)[-1])

    def recent_positions(self, agent: int, scene: Scene, steps_before: int = 0) -> NDArray[np.int64]:
        """(1 to steps_before + 1,) path positions of an agent then and `steps_before` steps before."""
        positions, now = self.positions(agent), scene.step - self.scene.step
        first, last = (min(max(step, 0), len(positions) - 1) for step in (now - steps_before, now))
        return positions[first : last + 1]

    def first_step(self, agents: Iterable[int], positions: Iterable[int]) -> int:
        """The first control step at which agents are at these path positions, all at once."""
        matches = [
            self.positions(agent) == position for agent, position in zip(agents, positions, strict=True)
        ]
        return int(np.flatnonzero(np.all(matches, axis=0))[0])

    def step_end_s(self, step: int) -> float:
        """End of a control step, on the clock of the episode."""
        return self.begins_s + step * CONTROL_DT_S

    def time_s(self, agent: int, position: int) -> float:
        """Time at which an agent first is at a path position, on the clock of the episode."""
        return self.step_end_s(int(np.searchsorted(self.positions(agent), position)))

    def doing(self, agents: Iterable[int], positions: Iterable[int]) -> tuple[Doing | None, ...]:
        """Activity of each of these agents at its path position."""
        pairs = zip(map(self.trajectory, agents), positions, strict=True)
        return tuple(doing(trajectory.segment_at(int(position))) for trajectory, position in pairs)


def resampled(segment: Segment, path: NDArray[np.float64], positions: NDArray[np.float64]) -> Segment:
    """The same motion at `positions` (T,) of its own path (len + 1, dof + 1), linearly interpolated."""
    rows = np.column_stack([np.interp(positions, np.arange(len(path)), column) for column in path.T])
    hinge_rad = segment.hinge_rad
    if hinge_rad is not None:
        hinge_rad = np.interp(positions, np.arange(1, len(path)), hinge_rad)
    return replace(segment, qpos=arm_of(rows), gripper=gripper_of(rows), hinge_rad=hinge_rad)


def _refined(trajectory: Trajectory) -> Trajectory:
    """The same motion with REFINEMENT positions for each path position."""
    path, segments = trajectory.path(), []
    for segment, start, end in trajectory.intervals:
        positions = np.arange(1, REFINEMENT * len(segment) + 1) / REFINEMENT
        segments.append(resampled(segment, path[start : end + 1], positions))
    return replace(trajectory, segments=tuple(segments))
