"""Why there is no schedule, and what would help: the answer of the search as a violation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import search
from rf_exp.coordination.diagrams import UNREACHABLE, blocked_region, remaining
from rf_exp.findings import About, Cause, CheckName, Doing, Finding, Violation
from rf_exp.geometry import Mask
from rf_exp.types import CONTROL_DT_S, Trajectory, doing


@dataclass(frozen=True, eq=False)
class Unscheduled:
    """A problem without a solution. Agents from 1; masks over positions on their paths."""

    trajectories: Sequence[Trajectory]
    diagrams: Mapping[tuple[int, int], Mask]  # which pairs of positions are too close
    begins_s: float  # when the schedule would begin, since the start of the episode

    def why(
        self, answer: search.Impossible, problem: search.Problem, real: tuple[NDArray[np.int64], ...]
    ) -> Violation:
        """`real`: the position on its path of each position of the problem, by agent."""
        if not answer.proven:
            return self._all(Finding.NO_SCHEDULE)
        if answer.pair is not None:
            return self._pair(answer.pair, problem, real)
        return self._late(problem) or self._all(Finding.NOT_ALL)

    def unequal(self, a: int, b: int, label: str, steps: int) -> Violation:
        """Two that move as one under a label plan motions of which one is so many control steps longer."""
        longer_s = steps * CONTROL_DT_S
        return self._found(Finding.UNEQUAL, longer_s, unit="s", agents=(a, b), subgoals=(label,))

    def _all(self, finding: Finding) -> Violation:
        everyone = tuple(trajectory.agent for trajectory in self.trajectories)
        return self._found(finding, agents=everyone)

    def _pair(
        self, pair: tuple[int, int], problem: search.Problem, real: tuple[NDArray[np.int64], ...]
    ) -> Violation:
        """Two that cannot pass each other: for room, or for the orders that are demanded."""
        i, j = pair[0] + 1, pair[1] + 1
        a, b = self.trajectories[i - 1], self.trajectories[j - 1]
        collision = self.diagrams.get((i, j))
        found = None if collision is None else _collision(a, b, collision)
        if collision is not None and found is not None:
            finding, doing = found
            cause, share = Cause.SPACE, float(collision.mean())  # of the pairs that are too close
        else:
            row, column = blocked_region(
                problem.diagrams[pair], sorted(problem.knots[i - 1]), sorted(problem.knots[j - 1])
            )
            ways = collision is not None and collision.any()
            finding = Finding.ORDERS_OR_WAYS if ways else Finding.ORDERS
            doing = _at(a, int(real[i - 1][row])), _at(b, int(real[j - 1][column]))
            cause, share = Cause.TIME, 0.0
        return self._found(finding, share, cause=cause, agents=(i, j), doing=doing)

    def _late(self, problem: search.Problem) -> Violation | None:
        """The deadline that is missed by most; None where deadlines are not what is in the way."""
        free = search.solve(search.Problem(problem.knots, problem.lengths, problem.diagrams))
        if not problem.deadlines or not isinstance(free, search.Found):
            return None
        late = []
        for agent, position, latest in problem.deadlines:
            reached = int(np.searchsorted(free.positions[:, agent], position))
            late.append((reached - latest, agent + 1, reached * CONTROL_DT_S, latest * CONTROL_DT_S))
        _, agent, needed_s, allowed_s = max(late)
        return self._found(Finding.DEADLINE, needed_s, allowed_s, unit="s", after_s=needed_s, agents=(agent,))

    def _found(
        self,
        finding: Finding,
        value: float = 0.0,
        bound: float = 0.0,
        *,
        unit: str = "",
        after_s: float = 0.0,
        cause: Cause = Cause.TIME,
        **about: Unpack[About],
    ) -> Violation:
        """`after_s`: when it happens, since the schedule would begin."""
        return Violation(
            check=CheckName.SCHEDULING,
            cause=cause,
            finding=finding,
            value=value,
            bound=bound,
            unit=unit,
            time_s=self.begins_s + after_s,
            **about,
        )


def _collision(
    a: Trajectory, b: Trajectory, collision: Mask
) -> tuple[Finding, tuple[Doing | None, ...]] | None:
    """Why collisions alone leave no way, and where both are then; None when they do leave one."""
    if remaining(collision, frozenset(a.knots), frozenset(b.knots))[0, 0] < UNREACHABLE:
        return None
    if collision[0, 0]:
        return Finding.CLOSE_AT_FIRST, ()
    if collision[-1, -1]:
        return Finding.CLOSE_AT_LAST, (_at(a, len(a)), _at(b, len(b)))
    for moving, diagram in ((a, collision), (b, collision.T)):
        walls = np.flatnonzero(diagram.all(axis=1))
        if not len(walls):
            walls = np.flatnonzero(diagram[:, 0] & diagram[:, -1])
        if len(walls):  # the other one stands
            blocked = _at(moving, int(walls[0]))
            return Finding.PARKED, (blocked, None) if moving is a else (None, blocked)
    row, column = blocked_region(collision, a.knots, b.knots)
    return Finding.BLOCKED_BOTH, (_at(a, row), _at(b, column))


def _at(trajectory: Trajectory, position: int) -> Doing | None:
    """Where on its path an agent is; None: where it stands."""
    return doing(trajectory.segment_at(position), position * CONTROL_DT_S)
