"""Assignment of jobs to agents that minimises the largest load.

This is the makespan of unrelated machines (R || Cmax in the notation of Graham et al. 1979), solved as a
mixed-integer program by HiGHS (`scipy.optimize.milp`), which proves its answer or bounds its error.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

NODES = 500  # limit of the search; with no time limit, the answer is the same on every machine
UNIT_S = 1e-3  # resolution of time
NEAR = 1e-3  # tolerance, in units

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
        return self.largest_s <= self.bound_s + UNIT_S * NEAR


def assign(takes_s: Floats, has_s: Floats | None = None) -> Assignment | None:
    """Agents for all jobs, or None where no agent can do one of them.

    `takes_s` (J, N) is the duration of each job for each agent, infinite where it cannot; `has_s` (N,) other
    load of each agent, by default 0. Both are rounded to milliseconds: estimates are no better, and whole
    numbers are exact. Of the assignments with the least largest load, one with the least total load.
    """
    jobs, agents = takes_s.shape
    takes, has = np.round(takes_s / UNIT_S), np.round((np.zeros(agents) if has_s is None else has_s) / UNIT_S)
    can = np.isfinite(takes)
    if not can.any(axis=1).all():
        return None
    if not jobs:
        return Assignment((), float(has.max() * UNIT_S), float(has.max() * UNIT_S))
    cost = np.where(can, takes, 0.0)
    # Unknowns: whether job j goes to agent n, row by row of (J, N), and the largest load.
    once = np.kron(np.eye(jobs), np.ones(agents))  # (J, J * N)
    loads = np.concatenate([np.diag(row) for row in cost], axis=1)  # (N, J * N)
    largest_load = np.append(np.zeros(jobs), -np.ones(agents))
    lowest: Any = np.append(np.ones(jobs), np.full(agents, -np.inf))  # typed as a number by scipy
    highest: Any = np.append(np.ones(jobs), -has)
    rules = LinearConstraint(np.column_stack([np.vstack([once, loads]), largest_load]), lowest, highest)

    def searched(weights: Floats, most: float) -> tuple[NDArray[np.int64] | None, float]:
        """The best (J,) agents found with loads up to `most`, and the proven bound."""
        upper: Any = np.append(can.ravel(), most)
        found = milp(
            c=weights,
            integrality=np.ones(jobs * agents + 1),
            bounds=Bounds(0.0, upper),
            constraints=rules,
            options={"node_limit": NODES},
        )
        bound = 0.0 if found.mip_dual_bound is None else float(np.ceil(found.mip_dual_bound - NEAR))
        return None if found.x is None else found.x[:-1].reshape(jobs, agents).argmax(axis=1), bound

    def largest(chosen: NDArray[np.int64]) -> float:
        return float(load_s(takes, chosen, has).max())

    chosen = greedy(takes, has)
    soonest, bound = searched(np.append(np.zeros(jobs * agents), 1.0), float(largest(chosen)))
    if soonest is not None and largest(soonest) < largest(chosen):
        chosen = soonest
    least, _ = searched(np.append(cost.ravel(), 0.0), largest(chosen))
    if least is not None and largest(least) <= largest(chosen):
        chosen = least
    bound = max(bound, float(has.max()), float(takes.min(axis=1).max()))
    return Assignment(tuple(map(int, chosen)), largest(chosen) * UNIT_S, bound * UNIT_S)


def load_s(takes_s: Floats, chosen: NDArray[np.integer], has_s: Floats) -> Floats:
    """(N,) load of each agent when jobs go to `chosen` (J,)."""
    loads_s = has_s.copy()
    np.add.at(loads_s, chosen, takes_s[np.arange(len(chosen)), chosen])
    return loads_s


def greedy(takes_s: Floats, has_s: Floats) -> NDArray[np.int64]:
    """(J,) agents: the longest job first, each to the agent that then finishes soonest."""
    loads_s, chosen = has_s.copy(), np.zeros(len(takes_s), np.int64)
    for job in np.argsort(-takes_s.min(axis=1), kind="stable"):
        chosen[job] = int((loads_s + takes_s[job]).argmin())
        loads_s[chosen[job]] += takes_s[job, chosen[job]]
    return chosen
