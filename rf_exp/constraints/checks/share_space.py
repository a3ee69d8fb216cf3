from dataclasses import dataclass
from math import inf

import numpy as np

from rf_exp.constraints.check import Check, Evidence
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification
from rf_exp.findings import CheckName, Finding, agent_names
from rf_exp.statements import ShareSpace
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S


@dataclass(frozen=True)
class ShareSpaceCheck(Check):
    """Agents may use the same space at different times: a permission, which always holds.

    Use at the same time is forbidden by the coordination diagrams of the spatial checks. The value is the
    least time in seconds between one agent leaving a place where the other would come too close and the other
    coming there; infinite where there is no such place.
    """

    statement_type, name, unit = ShareSpace, CheckName.SCHEDULING, "s"

    agents: tuple[int, ...]
    text: str = ""

    def __repr__(self) -> str:
        return f"VS({agent_names(self.agents)}, share space)"

    def planned(self, plan: Plan) -> Evidence:
        if not plan.paths.constraint_set.spatial:
            return self.not_applicable(plan, 0.0)
        pairs = [pair for pair in plan.paths.diagrams if set(pair) <= set(self.agents)]
        handovers = [_handover(plan, *pair) for pair in pairs if plan.paths.diagrams[pair].any()]
        if not handovers:
            return self.make_evidence(True, Finding.NOT_SHARED, inf, 0.0, plan.begins_s)
        gap_steps, arrival, agents = min(handovers)
        return self.make_evidence(
            True, Finding.SHARED, gap_steps * CONTROL_DT_S, 0.0, plan.step_end_s(arrival), agents=agents
        )

    def stl(self, task: Task) -> Specification:
        return Specification(no_formulas_reason="it is a permission, which no execution can violate")


def _handover(plan: Plan, i: int, j: int) -> tuple[int, int, tuple[int, int]]:
    """Shortest time between two agents' use of one space: steps, arrival of the second, (first, second).

    From the last step of the first at a path position to the first step of the second at one that is too
    close to it.
    """
    diagram = plan.paths.diagrams[i, j]  # (P_i, P_j)
    at_i, at_j = np.nonzero(diagram)
    (arrivals_i, departures_i), (arrivals_j, departures_j) = (
        [np.searchsorted(plan.positions(agent), range(count), side)[positions] for side in ("left", "right")]
        for agent, count, positions in zip((i, j), diagram.shape, (at_i, at_j), strict=True)
    )
    i_first, j_first = (
        arrivals_j - departures_i + 1,
        arrivals_i - departures_j + 1,
    )  # steps between; one is negative
    gap_steps = np.maximum(i_first, j_first)
    shortest = int(gap_steps.argmin())
    if i_first[shortest] > 0:
        return int(gap_steps[shortest]), int(arrivals_j[shortest]), (i, j)
    return int(gap_steps[shortest]), int(arrivals_i[shortest]), (j, i)
