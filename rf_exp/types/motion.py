"""What arms are to do, and when: subgoals, segments, trajectories, schedules."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Doing

ANYBODY = 0  # in the place of the number of an agent


@dataclass(frozen=True)
class Subgoal:
    """One step of one agent, e.g. agent 1: `grasp barrier at left`."""

    agent: int  # from 1; ANYBODY: who is chosen when it is planned
    verb: str  # grasp lift carry place strike press shut release home aside hold
    object: str | None = None
    point: str | None = None  # interaction point of `object`
    target: str | None = None  # where to carry, place or strike: an object or a named place
    target_point: str | None = None
    height_m: float | None = None  # lift: how far up; carry: how far above the target

    @property
    def names(self) -> frozenset[str]:
        """What it is about: objects, or a named place."""
        return frozenset(name for name in (self.object, self.target) if name is not None)

    @property
    def text(self) -> str:
        return self.what + (f" by {self.height_m:g} m" if self.height_m is not None else "")

    @property
    def what(self) -> str:
        """Its text without how far."""
        words = [self.verb]
        words += [self.object] if self.object else []
        words += ["at", self.point] if self.point else []
        words += ["to", self.target] if self.target else []
        words += ["at", self.target_point] if self.target_point else []
        return " ".join(words)


def what_of(text: str) -> str:
    """`Subgoal.what` of the text of a subgoal."""
    return text.partition(" by ")[0]


@dataclass(frozen=True)
class Segment:
    """One rest-to-rest motion of one agent on the control grid, made by one motion primitive.

    The arm stands still at both ends, so a schedule may wait between segments, never inside.
    """

    agent: int
    subgoal: Subgoal
    primitive: str  # move approach close lift carry lower open retreat press strike shut
    qpos: NDArray[np.float64]  # (T, dof) rad: the target at each control step; the start is not in it
    gripper: NDArray[np.float64]  # (T,) command in [-1 closed, 1 open]
    attached: str | None = None  # object that moves with the gripper
    tcp_from_object: NDArray[np.float64] | None = None  # (4, 4) of the attached object
    touches: frozenset[str] = frozenset()  # objects the gripper may touch here
    joined: str | None = None  # segments of several agents with one label run in lockstep
    opened_rad: NDArray[np.float64] | None = None  # (T,) of an attached thing that turns about its hinge

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def gripped(self) -> str | None:
        """What is attached, unless it is only pushed."""
        return self.attached if self.opened_rad is None else None

    @property
    def about(self) -> frozenset[str]:
        """What the agent has to do with here: objects, or a named place."""
        return self.touches | self.subgoal.names


@dataclass(frozen=True)
class Trajectory:
    """All segments of one agent for one proposal, from where it stands now."""

    agent: int
    start_qpos: NDArray[np.float64]  # (dof,) rad
    start_gripper: float
    segments: tuple[Segment, ...]

    @cached_property
    def knots(self) -> tuple[int, ...]:
        """Path positions at which the arm stands still: 0, then the end of each segment."""
        return tuple(np.cumsum([0, *map(len, self.segments)]).tolist())

    def __len__(self) -> int:
        return self.knots[-1]

    @property
    def intervals(self) -> Iterator[tuple[Segment, int, int]]:
        """Each segment with the path positions at which it begins and ends."""
        return zip(self.segments, self.knots[:-1], self.knots[1:], strict=True)

    def segment_at(self, position: int) -> Segment | None:
        """The segment that ends at or after a path position, beyond all the last; None without segments."""
        if not self.segments:
            return None
        # For every arm in every control step: an array of so few knots would take ten times as long.
        return self.segments[min(bisect_left(self.knots, position, 1) - 1, len(self.segments) - 1)]

    def path(self) -> NDArray[np.float64]:
        """(len + 1, dof + 1): joint target and gripper at each path position; 0 is the start. Read-only."""
        return self._path

    @cached_property
    def _path(self) -> NDArray[np.float64]:
        start = np.append(self.start_qpos, self.start_gripper)[None]
        rows = [np.column_stack([s.qpos, s.gripper]) for s in self.segments]
        path = np.concatenate([start, *rows])
        path.flags.writeable = False  # it is everybody's
        return path


@dataclass(frozen=True)
class Schedule:
    """When each agent is where on its path. Column k - 1 belongs to agent k."""

    positions: NDArray[np.int64]  # (T + 1, N) path position at each control step; row 0 is zeros
    makespan_bound: int  # proven lower bound on T, control steps
    # (T + 1, N) who stays in the step that leads here though nobody is in its way; None: nobody ever does
    hesitates: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.positions) - 1


@dataclass(frozen=True)
class Span:
    """A segment on the control steps of a schedule."""

    segment: Segment
    begins: int  # the step after which the arm leaves where the segment begins
    ends: int  # the step after which it is where the segment ends


@dataclass(frozen=True)
class Activity:
    """What an agent does in a control step of a schedule."""

    segment: Segment | None  # it is in, or waits for; None: it is done
    moves: bool


def spans(trajectory: Trajectory, schedule: Schedule) -> tuple[Span, ...]:
    """The segments of an agent, in their order."""
    positions = schedule.positions[:, trajectory.agent - 1]
    begins = np.searchsorted(positions, trajectory.knots[:-1], side="right") - 1
    ends = np.searchsorted(positions, trajectory.knots[1:])
    return tuple(map(Span, trajectory.segments, begins.tolist(), ends.tolist()))


def activity(trajectory: Trajectory, schedule: Schedule, step: int) -> Activity:
    """What an agent does in a step of a schedule, the first being 1; after its end nobody moves.

    Who stands at the end of one segment waits for the next.
    """
    last = min(step, len(schedule))
    before, now = schedule.positions[[last - 1, last], trajectory.agent - 1].tolist()
    moves = now > before and step == last
    if not moves and now == len(trajectory):
        return Activity(None, False)
    return Activity(trajectory.segment_at(now if moves else now + 1), moves)


def doing(segment: Segment | None, along_s: float | None = None) -> Doing | None:
    """What an agent is about in a segment, and for how long it has been on its way."""
    return None if segment is None else Doing(segment.subgoal.text, segment.primitive, along_s)
