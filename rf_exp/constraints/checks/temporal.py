"""Temporal constraints: order, simultaneity, delay, deadline (paper: Trajectory Scheduling Validation).

Each check says what it demands of a schedule (`demand`, cells of coordination diagrams) and
verifies a schedule by the clock (`planned`), independently of how the schedule was found.
"""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np

from rf_exp.constraints.evidence import Evidence, idle
from rf_exp.constraints.plan import Plan
from rf_exp.coordination import Demands, subgoal_runs
from rf_exp.findings import CheckName, Finding, names
from rf_exp.statements import TOGETHER_S, Step
from rf_exp.types import CONTROL_DT_S, CONTROL_HZ, Kind, Scene, Trajectory


def span(step: Step, trajectory: Trajectory) -> tuple[int, int] | None:
    """First and last path position of a part of a plan; None when the trajectory has no such part."""
    found: list[int] = []
    start = 0
    for subgoal, segments in subgoal_runs(trajectory):
        end = start + sum(map(len, segments))
        if step.verb is None or (subgoal.verb, subgoal.object) == (step.verb, step.object):
            found += [start, end]
        start = end
    return (found[0], found[-1]) if found else None


def times_s(step: Step, plan: Plan) -> tuple[float, float] | None:
    """When a part makes its first step and when it has made its last, since the start of the plan."""
    positions_of = span(step, plan.trajectory(step.agent))
    if positions_of is None:
        return None
    positions = plan.positions(step.agent)
    begins = int(np.searchsorted(positions, positions_of[0], "right"))
    ends = int(np.searchsorted(positions, positions_of[1]))
    return begins * CONTROL_DT_S, ends * CONTROL_DT_S


@dataclass(frozen=True)
class _Temporal:
    """What the temporal checks have in common."""

    kind: ClassVar[Kind] = "temporal"
    name: ClassVar[CheckName] = CheckName.SCHEDULING
    unit: ClassVar[str] = "s"

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        return None  # commands follow the schedule step by step; lagging behind is the monitor's tracking


@dataclass(frozen=True)
class Sequential(_Temporal):
    """One part is over before another begins, with a pause of `wait_s` between. Values in seconds."""

    first: Step
    then: Step
    wait_s: float = 0.0
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return self.first.agent, self.then.agent

    def __repr__(self) -> str:
        wait = f", wait {self.wait_s:g} s" if self.wait_s else ""
        return f"VS({names(self.agents)}, sequential{_about(self.first)}{_about(self.then)}{wait})"

    def demand(self, demands: Demands) -> None:
        first = span(self.first, demands.trajectory(self.first.agent))
        then = span(self.then, demands.trajectory(self.then.agent))
        if first is None or then is None:
            return
        demands.before(self.first.agent, first[1], self.then.agent, then[0])
        if self.wait_s > 0:
            steps = int(np.ceil(self.wait_s * CONTROL_HZ - 1e-9))
            demands.delay(self.first.agent, first[1], self.then.agent, then[0], steps)

    def planned(self, plan: Plan) -> Evidence:
        first, then = times_s(self.first, plan), times_s(self.then, plan)
        if first is None or then is None:
            return idle(plan, self.agents, bound=self.wait_s)
        pause_s = then[0] - first[1]
        return Evidence(
            ok=pause_s >= self.wait_s - 1e-9,
            finding=Finding.TOO_SOON,
            value=pause_s,
            bound=self.wait_s,
            time_s=plan.begins_s + then[0],
            agents=self.agents,
            subgoals=(self.first.text, self.then.text),
        )


@dataclass(frozen=True)
class Simultaneous(_Temporal):
    """Several agents begin the same part at most `within_s` apart. Value and bound in seconds."""

    steps: tuple[Step, ...]
    within_s: float = TOGETHER_S
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(step.agent for step in self.steps)

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, simultaneous{_about(self.steps[0])}, within {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        spans = [(step.agent, span(step, demands.trajectory(step.agent))) for step in self.steps]
        within = int(min(self.within_s, 1e6) * CONTROL_HZ + 1e-9)
        for index, (a, span_a) in enumerate(spans):
            for b, span_b in spans[index + 1 :]:
                if span_a is not None and span_b is not None:
                    demands.together(a, span_a[0], b, span_b[0], within)

    def planned(self, plan: Plan) -> Evidence:
        begins = [times[0] for step in self.steps if (times := times_s(step, plan)) is not None]
        if len(begins) < 2:
            return idle(plan, self.agents, bound=self.within_s)
        apart_s = max(begins) - min(begins)
        what = f"{self.steps[0].verb} {self.steps[0].object}" if self.steps[0].verb else "their tasks"
        return Evidence(
            ok=apart_s <= self.within_s + 1e-9,
            finding=Finding.NOT_TOGETHER,
            value=apart_s,
            bound=self.within_s,
            time_s=plan.begins_s + max(begins),
            agents=self.agents,
            subgoals=(what,),
        )


@dataclass(frozen=True)
class Deadline(_Temporal):
    """A part is over in time. Value and bound in seconds since the start of the plan."""

    step: Step
    within_s: float
    text: str = ""

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.step.agent,)

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, deadline{_about(self.step)}, {self.within_s:g} s)"

    def demand(self, demands: Demands) -> None:
        part = span(self.step, demands.trajectory(self.step.agent))
        if part is not None:
            demands.deadline(self.step.agent, part[1], int(min(self.within_s, 1e6) * CONTROL_HZ + 1e-9))

    def planned(self, plan: Plan) -> Evidence:
        times = times_s(self.step, plan)
        if times is None:
            return idle(plan, self.agents, bound=self.within_s)
        return Evidence(
            ok=times[1] <= self.within_s + 1e-9,
            finding=Finding.TOO_LATE,
            value=times[1],
            bound=self.within_s,
            time_s=plan.begins_s + times[1],
            agents=self.agents,
            subgoals=(self.step.text,),
        )


@dataclass(frozen=True)
class ShareSpace(_Temporal):
    """Agents may use the same space at different times: a permission, which takes nothing away.

    That they are never there at the same time is what the diagrams of the spatial checks forbid. The value
    is the least time in seconds between one leaving a place where the other would meet it and the other
    coming there; infinite where there is no such place.
    """

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VS({names(self.agents)}, share space)"

    def demand(self, demands: Demands) -> None:
        """Nothing: the diagrams say what to keep apart."""

    def planned(self, plan: Plan) -> Evidence:
        if not plan.constraint_set.spatial:
            return idle(plan, self.agents, bound=0.0)
        pairs = [pair for pair in plan.paths.diagrams if set(pair) <= set(self.agents)]
        found = [_handover(plan, *pair) for pair in pairs if plan.paths.diagrams[pair].any()]
        if not found:
            return Evidence(
                ok=True,
                finding=Finding.NOT_SHARED,
                value=inf,
                bound=0.0,
                time_s=plan.begins_s,
                agents=self.agents,
            )
        apart, comes, agents = min(found)
        return Evidence(
            ok=True,
            finding=Finding.SHARED,
            value=apart * CONTROL_DT_S,
            bound=0.0,
            time_s=plan.begins_s + comes * CONTROL_DT_S,
            agents=agents,
        )


def _handover(plan: Plan, i: int, j: int) -> tuple[int, int, tuple[int, int]]:
    """The closest that two agents come, in time, to using one space: steps, when, and who is first.

    From the last step of the first at a path position to the first step of the other at one that is too
    close to it.
    """
    diagram = plan.paths.diagrams[i, j]  # (P_i, P_j)
    at_i, at_j = np.nonzero(diagram)
    (comes_i, leaves_i), (comes_j, leaves_j) = (
        [np.searchsorted(plan.positions(agent), range(count), side)[at] for side in ("left", "right")]
        for agent, count, at in zip((i, j), diagram.shape, (at_i, at_j), strict=True)
    )
    i_first, j_first = comes_j - leaves_i + 1, comes_i - leaves_j + 1  # steps between; one is negative
    apart = np.maximum(i_first, j_first)
    nearest = int(apart.argmin())
    if i_first[nearest] > 0:
        return int(apart[nearest]), int(comes_j[nearest]), (i, j)
    return int(apart[nearest]), int(comes_i[nearest]), (j, i)


def _about(step: Step) -> str:
    return f", {step.verb} {step.object}" if step.verb else ""
