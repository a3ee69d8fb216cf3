"""Beginning and end of parts of plans: as path positions, times and signals; base of checks on them."""

from abc import abstractmethod
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import Check
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import (
    MAX_MARGIN,
    TIME_TOLERANCE_S,
    Execution,
    Signal,
    condition_values,
    identifier,
)
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName
from rf_exp.statements import Step
from rf_exp.types import CONTROL_DT_S, CONTROL_HZ, Trajectory


def span(step: Step, trajectory: Trajectory) -> tuple[int, int] | None:
    """First and last path position of a part of a plan; None when the trajectory has no such part."""
    bounds: list[int] = []
    for segment, start, end in trajectory.intervals:
        if step.verb is None or (segment.subgoal.verb, segment.subgoal.object) == (step.verb, step.object):
            bounds += [start, end]
    return (bounds[0], bounds[-1]) if bounds else None


def times_s(step: Step, plan: Plan) -> tuple[float, float] | None:
    """Times of a part's first and last step since the start of the plan; None where the plan lacks it."""
    part, positions = span(step, plan.trajectory(step.agent)), plan.positions(step.agent)
    if part is None:
        return None
    begins, ends = np.searchsorted(positions, part[0], "right"), np.searchsorted(positions, part[1])
    return int(begins) * CONTROL_DT_S, int(ends) * CONTROL_DT_S


class TimedCheck(Check):
    """A check of the times at which commanded parts of plans begin and end. Value and bound in seconds.

    Paper: Trajectory Scheduling Validation.
    """

    name, unit = CheckName.SCHEDULING, "s"

    steps: tuple[Step, ...]  # the parts

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(step.agent for step in self.steps)

    def rule(self, paths: Paths) -> Self:
        return self

    @abstractmethod
    def demand(self, demands: Demands) -> None:
        """Adds what it forbids to the demands on a schedule."""

    def spans(self, demands: Demands) -> list[tuple[int, int, int]]:
        """(agent, first path position, last one) of its parts that the plan has."""
        spans = [(step.agent, span(step, demands.trajectory(step.agent))) for step in self.steps]
        return [(agent, *positions) for agent, positions in spans if positions is not None]

    def times_s(self, plan: Plan) -> list[tuple[float, float]]:
        """Beginning and end of its parts that the plan has, since the start of the plan."""
        times = [times_s(step, plan) for step in self.steps]
        return [interval for interval in times if interval is not None]


def steps_within(within_s: float) -> int:
    """The largest number of control steps within a time."""
    return int(min(within_s, 1e6) * CONTROL_HZ + 1e-9)


def elapsed_signal(step: Step, edge: Literal["begin", "end"]) -> Signal:
    """Signal of the time in s since the first or the last step of a part; negative before it."""

    def elapsed_s(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        if times is None:  # a part that is not in the plan violates nothing
            return np.full(len(execution), MAX_MARGIN)
        return execution.clock_s - times[edge == "end"]

    step_name = "last" if edge == "end" else "first"
    description = f"since the command of the {step_name} step of {step.text}; negative before it"
    return Signal(identifier("since", edge, *step_name_parts(step)), "s", description, elapsed_s)


def begun_signal(step: Step) -> Signal:
    def has_begun(execution: Execution) -> NDArray[np.float64]:
        begins_s, _ = times_s(step, execution.plan) or (np.inf, np.inf)
        return condition_values(execution.clock_s >= begins_s - TIME_TOLERANCE_S)

    name, description = (
        identifier("begun", *step_name_parts(step)),
        f"{step.text} has begun, by the commands given",
    )
    return Signal(name, "", description, has_begun)


def step_name_parts(step: Step) -> tuple[object, ...]:
    """Parts of the name of a signal about a step."""
    return step.agent, *(part for part in (step.verb, step.object) if part)


def step_suffix(step: Step) -> str:
    return f", {step.action_text('')}" if step.verb else ""
