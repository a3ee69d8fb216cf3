"""Beginning and end of parts of plans: as path positions, times and signals; base of checks on them."""

from abc import abstractmethod
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import Check
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import CLOCK_S, VOID, Execution, Signal, condition, named
from rf_exp.coordination import Demands
from rf_exp.findings import CheckName
from rf_exp.statements import Step
from rf_exp.types import CONTROL_DT_S, CONTROL_HZ, Trajectory


def span(step: Step, trajectory: Trajectory) -> tuple[int, int] | None:
    """First and last path position of a part of a plan; None when the trajectory has no such part."""
    found: list[int] = []
    for segment, start, end in trajectory.intervals:
        if step.verb is None or (segment.subgoal.verb, segment.subgoal.object) == (step.verb, step.object):
            found += [start, end]
    return (found[0], found[-1]) if found else None


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
        found = [(step.agent, span(step, demands.trajectory(step.agent))) for step in self.steps]
        return [(agent, *positions) for agent, positions in found if positions is not None]

    def times_s(self, plan: Plan) -> list[tuple[float, float]]:
        """Beginning and end of its parts that the plan has, since the start of the plan."""
        found = [times_s(step, plan) for step in self.steps]
        return [each for each in found if each is not None]


def steps_within(within_s: float) -> int:
    """The largest number of control steps within a time."""
    return int(min(within_s, 1e6) * CONTROL_HZ + 1e-9)


def since(step: Step, edge: Literal["begin", "end"]) -> Signal:
    """Signal of the time in s since the first or the last step of a part; negative before it."""

    def since_s(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        if times is None:  # a part that is not in the plan violates nothing
            return np.full(len(execution), VOID)
        return execution.clock_s - times[edge == "end"]

    last = "last" if edge == "end" else "first"
    how = f"since the command of the {last} step of {step.text}; negative before it"
    return Signal(named("since", edge, *step_parts(step)), "s", how, since_s)


def begun(step: Step) -> Signal:
    def has_begun(execution: Execution) -> NDArray[np.float64]:
        begins_s, _ = times_s(step, execution.plan) or (np.inf, np.inf)
        return condition(execution.clock_s >= begins_s - CLOCK_S)

    name, how = named("begun", *step_parts(step)), f"{step.text} has begun, by the commands given"
    return Signal(name, "", how, has_begun)


def step_parts(step: Step) -> tuple[object, ...]:
    """Parts of the name of a signal about a step."""
    return step.agent, *(part for part in (step.verb, step.object) if part)


def about(step: Step) -> str:
    return f", {step.does('')}" if step.verb else ""
