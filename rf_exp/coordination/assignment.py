"""Assignment of jobs to agents that minimises the largest load.

This is the makespan of unrelated machines (R || Cmax in the notation of Graham et al. 1979), solved as a
mixed-integer program by HiGHS (`scipy.optimize.milp`), which proves its answer or bounds its error.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

MAX_NODES = 500  # limit of the search; with no time limit, the answer is the same on every machine
RESOLUTION_S = 1e-3  # of time
TOLERANCE = 1e-3  # in units of RESOLUTION_S

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Assignment:
    """Assignment of jobs to agents."""

    agents: tuple[int, ...]  # of each job, from 0
    largest_s: float  # largest load of an agent
    bound_s: float  # proven lower bound on the largest load

    @property
    def optimal(self) -> bool:
        """Whether the largest load is proven to be minimal."""
        return self.largest_s <= self.bound_s + RESOLUTION_S * TOLERANCE


def assign(durations_s: Floats, initial_loads_s: Floats | None = None) -> Assignment | None:
    """Agents for all jobs, or None where no agent can do one of them.

    `durations_s` (J, N) is the duration of each job for each agent, infinite where it cannot do it;
    `initial_loads_s` (N,) is other load of each agent, by default 0. Both are rounded to milliseconds:
    estimates are no better, and whole numbers are exact. Of the assignments with the least largest load, one
    with the least total load.
    """
    jobs, agents = durations_s.shape
    durations, initial_loads = (
        np.round(durations_s / RESOLUTION_S),
        np.round((np.zeros(agents) if initial_loads_s is None else initial_loads_s) / RESOLUTION_S),
    )
    feasible = np.isfinite(durations)
    if not feasible.any(axis=1).all():
        return None
    if not jobs:
        return Assignment(
            (), float(initial_loads.max() * RESOLUTION_S), float(initial_loads.max() * RESOLUTION_S)
        )
    cost = np.where(feasible, durations, 0.0)
    # Unknowns: whether job j goes to agent n, row by row of (J, N), and the largest load.
    one_agent_per_job = np.kron(np.eye(jobs), np.ones(agents))  # (J, J * N)
    loads = np.concatenate([np.diag(row) for row in cost], axis=1)  # (N, J * N)
    minus_largest = np.append(np.zeros(jobs), -np.ones(agents))
    row_lower: Any = np.append(np.ones(jobs), np.full(agents, -np.inf))  # typed as a number by scipy
    row_upper: Any = np.append(np.ones(jobs), -initial_loads)
    constraints = LinearConstraint(
        np.column_stack([np.vstack([one_agent_per_job, loads]), minus_largest]), row_lower, row_upper
    )

    def solved(weights: Floats, max_load: float) -> tuple[NDArray[np.int64] | None, float]:
        """The best (J,) agents found with loads up to `most`, and the proven bound."""
        upper: Any = np.append(feasible.ravel(), max_load)
        result = milp(
            c=weights,
            integrality=np.ones(jobs * agents + 1),
            bounds=Bounds(0.0, upper),
            constraints=constraints,
            options={"node_limit": MAX_NODES},
        )
        bound = 0.0 if result.mip_dual_bound is None else float(np.ceil(result.mip_dual_bound - TOLERANCE))
        return None if result.x is None else result.x[:-1].reshape(jobs, agents).argmax(axis=1), bound

    def largest_load(assigned: NDArray[np.int64]) -> float:
        return float(agent_loads_s(durations, assigned, initial_loads).max())

    assigned = greedy(durations, initial_loads)
    balanced, bound = solved(np.append(np.zeros(jobs * agents), 1.0), float(largest_load(assigned)))
    if balanced is not None and largest_load(balanced) < largest_load(assigned):
        assigned = balanced
    cheapest, _ = solved(np.append(cost.ravel(), 0.0), largest_load(assigned))
    if cheapest is not None and largest_load(cheapest) <= largest_load(assigned):
        assigned = cheapest
    bound = max(bound, float(initial_loads.max()), float(durations.min(axis=1).max()))
    return Assignment(tuple(map(int, assigned)), largest_load(assigned) * RESOLUTION_S, bound * RESOLUTION_S)


def agent_loads_s(durations_s: Floats, assigned: NDArray[np.integer], initial_loads_s: Floats) -> Floats:
    """(N,) load of each agent when jobs go to `chosen` (J,)."""
    loads_s = initial_loads_s.copy()
    np.add.at(loads_s, assigned, durations_s[np.arange(len(assigned)), assigned])
    return loads_s


def greedy(durations_s: Floats, initial_loads_s: Floats) -> NDArray[np.int64]:
    """(J,) agents: the longest job first, each to the agent that then finishes soonest."""
    loads_s, assigned = initial_loads_s.copy(), np.zeros(len(durations_s), np.int64)
    for job in np.argsort(-durations_s.min(axis=1), kind="stable"):
        assigned[job] = int((loads_s + durations_s[job]).argmin())
        loads_s[assigned[job]] += durations_s[job, assigned[job]]
    return assigned
