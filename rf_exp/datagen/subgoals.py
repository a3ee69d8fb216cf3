"""Subgoal labels of an episode: the number of each agent's subgoal at every control step."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import Schedule, Trajectory, without_height

IDLE = "hold"  # text for an agent that has had no subgoal yet
NO_SUBGOAL = -1  # number where the subgoal is unknown


class Subgoals:
    """The subgoals of one episode. Those of each agent are numbered from 0, over all plans."""

    def __init__(self, agents: int, known: Sequence[Iterable[str]] = ()) -> None:
        """`known` subgoals of each agent, from other episodes of the task, keep their numbers from there."""
        # Per agent: number -> text.
        self.texts: list[list[str]] = [list(texts) for texts in known] or [[] for _ in range(agents)]
        self._known = bool(known)

    def number_steps(self, trajectories: Sequence[Trajectory], schedule: Schedule) -> NDArray[np.int16]:
        """(T + 1, N): row t is the subgoal of the command at step t of the schedule, row 0 the first one."""
        columns = []
        for trajectory, texts in zip(trajectories, self.texts, strict=True):
            numbers, last_subgoal = [], None
            for segment in trajectory.segments:
                name = segment.subgoal.text_without_height
                known_names = [without_height(text) for text in texts] if self._known else []
                if segment.subgoal != last_subgoal and name not in known_names:
                    texts.append(segment.subgoal.text)
                    known_names.append(name)
                last_subgoal = segment.subgoal
                numbers.append(known_names.index(name) if self._known else len(texts) - 1)
            if not numbers:
                texts += [] if texts else [IDLE]
                columns.append(np.full(len(schedule) + 1, len(texts) - 1))
                continue
            positions = schedule.positions[:, trajectory.agent - 1]
            waits = np.diff(positions, prepend=-1) == 0
            # A command to a position belongs to the segment that ends there or later; a wait, to the next.
            segment_of = np.searchsorted(trajectory.knots[1:], positions + waits, side="left")
            columns.append(np.array(numbers)[np.minimum(segment_of, len(numbers) - 1)])
        return np.stack(columns, axis=1).astype(np.int16)
