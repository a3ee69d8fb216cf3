"""What each agent is about at every control step of an episode: its subgoals, numbered as they come."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import Schedule, Trajectory, what_of

IDLE = "hold"  # the text of an agent that has not been told anything yet
NOBODYS = -1  # the number where it is not known what an agent is about


class Subgoals:
    """The subgoals of one episode. An agent's own are numbered from 0, over all its plans."""

    def __init__(self, agents: int, known: Sequence[Iterable[str]] = ()) -> None:
        """What is `known` of each agent, from other episodes of the task, has the number it has there."""
        # For each agent the texts that the numbers stand for.
        self.texts: list[list[str]] = [list(texts) for texts in known] or [[] for _ in range(agents)]
        self._known = bool(known)

    def of_plan(self, trajectories: Sequence[Trajectory], schedule: Schedule) -> NDArray[np.int16]:
        """(T + 1, N): row t is what the command of step t of the schedule is for, row 0 what comes first."""
        columns = []
        for trajectory, texts in zip(trajectories, self.texts, strict=True):
            numbers, before = [], None
            for segment in trajectory.segments:
                what = segment.subgoal.what
                named = [what_of(text) for text in texts] if self._known else []
                if segment.subgoal != before and what not in named:
                    texts.append(segment.subgoal.text)
                    named.append(what)
                before = segment.subgoal
                numbers.append(named.index(what) if self._known else len(texts) - 1)
            if not numbers:
                texts += [] if texts else [IDLE]
                columns.append(np.full(len(schedule) + 1, len(texts) - 1))
                continue
            positions = schedule.positions[:, trajectory.agent - 1]
            waits = np.diff(positions, prepend=-1) == 0
            # A command to a position is part of the segment that ends there or later; a wait, of the next.
            segment_of = np.searchsorted(trajectory.knots[1:], positions + waits, side="left")
            columns.append(np.array(numbers)[np.minimum(segment_of, len(numbers) - 1)])
        return np.stack(columns, axis=1).astype(np.int16)
