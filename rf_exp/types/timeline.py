"""Who does what when: the segments of a plan on the control steps of its schedule."""

from dataclasses import dataclass

import numpy as np

from rf_exp.findings import Doing
from rf_exp.types.motion import Schedule, Segment, Trajectory


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
