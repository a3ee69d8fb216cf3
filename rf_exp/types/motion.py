"""Plans of arms and their timing: subgoals, segments, trajectories, schedules."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Doing

ANY_AGENT = 0  # in place of an agent's number: any agent


@dataclass(frozen=True)
class Subgoal:
    """One step of one agent, e.g. agent 1: `grasp barrier at left`."""

    agent: int  # from 1; ANY_AGENT: chosen by the planner
    verb: str  # grasp lift carry place strike press shut release home aside hold
    object: str | None = None
    point: str | None = None  # interaction point of `object`
    target: str | None = None  # where to carry, place or strike: an object or a named place
    target_point: str | None = None
    height_m: float | None = None  # lift: how far up; carry: how far above the target

    @property
    def names(self) -> frozenset[str]:
        """Names of its object and its target, which may be a named place."""
        return frozenset(name for name in (self.object, self.target) if name is not None)

    @property
    def text(self) -> str:
        return self.text_without_height + (f" by {self.height_m:g} m" if self.height_m is not None else "")

    @property
    def text_without_height(self) -> str:
        """Its text without the height."""
        words = [self.verb]
        words += [self.object] if self.object else []
        words += ["at", self.point] if self.point else []
        words += ["to", self.target] if self.target else []
        words += ["at", self.target_point] if self.target_point else []
        return " ".join(words)


def without_height(text: str) -> str:
    """`Subgoal.text_without_height` of the text of a subgoal."""
    return text.partition(" by ")[0]


@dataclass(frozen=True)
class Segment:
    """One rest-to-rest motion of one agent on the control grid, planned by one motion primitive.

    The arm is at rest at both ends, so a schedule may wait between segments, never inside.
    """

    agent: int
    subgoal: Subgoal
    primitive: str  # move approach close lift carry lower open retreat press strike shut
    qpos: NDArray[np.float64]  # (T, dof) rad: the target at each control step, without the start
    gripper: NDArray[np.float64]  # (T,) command in [-1 closed, 1 open]
    attached: str | None = None  # object that moves with the gripper
    tcp_from_object: NDArray[np.float64] | None = None  # (4, 4) of the attached object
    touches: frozenset[str] = frozenset()  # objects the gripper may touch here
    joined: str | None = None  # segments of several agents with one label run in lockstep
    hinge_rad: NDArray[np.float64] | None = None  # (T,) hinge angle of an attached object that is pushed

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def grasped_object(self) -> str | None:
        """The attached object, unless it is only pushed."""
        return self.attached if self.hinge_rad is None else None

    @property
    def involved_names(self) -> frozenset[str]:
        """Names of the objects and of the named place that the segment involves."""
        return self.touches | self.subgoal.names


@dataclass(frozen=True)
class Trajectory:
    """All segments of one agent for one proposal, from its present configuration."""

    agent: int
    start_qpos: NDArray[np.float64]  # (dof,) rad
    start_gripper: float
    segments: tuple[Segment, ...]

    @cached_property
    def knots(self) -> tuple[int, ...]:
        """Path positions at which the arm is at rest: 0, then the end of each segment."""
        return tuple(np.cumsum([0, *map(len, self.segments)]).tolist())

    def __len__(self) -> int:
        return self.knots[-1]

    @property
    def intervals(self) -> Iterator[tuple[Segment, int, int]]:
        """Each segment with the path positions at which it begins and ends."""
        return zip(self.segments, self.knots[:-1], self.knots[1:], strict=True)

    def segment_at(self, position: int) -> Segment | None:
        """The first segment that ends at or after a path position, else the last; None without segments."""
        if not self.segments:
            return None
        # Called for every arm in every control step: NumPy takes ten times as long for so few knots.
        return self.segments[min(bisect_left(self.knots, position, 1) - 1, len(self.segments) - 1)]

    def path(self) -> NDArray[np.float64]:
        """(len + 1, dof + 1): joint target and gripper at each path position; 0 is the start. Read-only."""
        return self._path

    @cached_property
    def _path(self) -> NDArray[np.float64]:
        start = np.append(self.start_qpos, self.start_gripper)[None]
        rows = [np.column_stack([segment.qpos, segment.gripper]) for segment in self.segments]
        path = np.concatenate([start, *rows])
        path.flags.writeable = False  # shared between callers
        return path


@dataclass(frozen=True)
class Schedule:
    """Path positions of all agents over time. Column k - 1 belongs to agent k."""

    positions: NDArray[np.int64]  # (T + 1, N) path position at each control step; row 0 is zeros
    makespan_bound: int  # proven lower bound on T, control steps
    # (T + 1, N) the agent stays in the step that leads to this row though its way is free; None: never
    hesitates: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.positions) - 1


@dataclass(frozen=True)
class Span:
    """Control steps of a segment in a schedule."""

    segment: Segment
    begins: int  # the last step after which the arm is still at the start of the segment
    ends: int  # the first step after which it is at the end of the segment


@dataclass(frozen=True)
class Activity:
    """Activity of an agent in a control step of a schedule."""

    segment: Segment | None  # that it executes or waits for; None: it is done
    moves: bool


def spans(trajectory: Trajectory, schedule: Schedule) -> tuple[Span, ...]:
    """The spans of an agent's segments, in order."""
    positions = schedule.positions[:, trajectory.agent - 1]
    begins = np.searchsorted(positions, trajectory.knots[:-1], side="right") - 1
    ends = np.searchsorted(positions, trajectory.knots[1:])
    return tuple(map(Span, trajectory.segments, begins.tolist(), ends.tolist()))


def activity(trajectory: Trajectory, schedule: Schedule, step: int) -> Activity:
    """The activity of an agent in a step of a schedule, counted from 1; after its end no agent moves.

    An agent at the end of one segment waits for the next.
    """
    last = min(step, len(schedule))
    previous, current = schedule.positions[[last - 1, last], trajectory.agent - 1].tolist()
    moves = current > previous and step == last
    if not moves and current == len(trajectory):
        return Activity(None, False)
    return Activity(trajectory.segment_at(current if moves else current + 1), moves)


def doing(segment: Segment | None, along_s: float | None = None) -> Doing | None:
    """The subgoal and primitive of a segment, with `along_s` as given; None without a segment."""
    return None if segment is None else Doing(segment.subgoal.text, segment.primitive, along_s)
