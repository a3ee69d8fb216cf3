"""Who does what: jobs to agents, so that the one with most to do has as little as can be.

The least largest load of unrelated machines (R || Cmax in the notation of Graham et al. 1979), as a
mixed-integer program of HiGHS (`scipy.optimize.milp`), which proves its answer or says how far it may be off.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

NODES = 500  # of a search, which is counted and not timed: the answer is the same on every machine
UNIT_S = 1e-3  # in which time is counted
NEAR = 1e-3  # of a unit: differences that say nothing

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Assignment:
    """Jobs that have been given to agents."""

    agents: tuple[int, ...]  # of each job, from 0
    largest_s: float  # load of the agent that has most to do
    bound_s: float  # that of no assignment is smaller, proven

    @property
    def optimal(self) -> bool:
        """Whether it is proven that none has a smaller largest load."""
        return self.largest_s <= self.bound_s + UNIT_S * NEAR


def assign(takes_s: Floats, has_s: Floats | None = None) -> Assignment | None:
    """Agents for all jobs, or None where one can be done by nobody.

    `takes_s` (J, N) is how long each job takes each agent, infinite where it cannot; `has_s` (N,) what each
    has to do besides, nothing unless given. Both are rounded to milliseconds: estimates are no better, and
    whole numbers are exact. Of assignments with the least largest load it is one with the least work of all
    agents together.
    """
    jobs, agents = takes_s.shape
    takes, has = np.round(takes_s / UNIT_S), np.round((np.zeros(agents) if has_s is None else has_s) / UNIT_S)
    can = np.isfinite(takes)
    if not can.any(axis=1).all():
        return None
    if not jobs:
        return Assignment((), float(has.max() * UNIT_S), float(has.max() * UNIT_S))
    cost = np.where(can, takes, 0.0)
    # Unknowns: whether job j goes to agent n, all n of a job side by side, and the largest load.
    once = np.kron(np.eye(jobs), np.ones(agents))  # (J, J * N)
    loads = np.concatenate([np.diag(row) for row in cost], axis=1)  # (N, J * N)
    largest_load = np.append(np.zeros(jobs), -np.ones(agents))
    lowest: Any = np.append(np.ones(jobs), np.full(agents, -np.inf))  # typed as a number by scipy
    highest: Any = np.append(np.ones(jobs), -has)
    rules = LinearConstraint(np.column_stack([np.vstack([once, loads]), largest_load]), lowest, highest)

    def searched(weights: Floats, most: float) -> tuple[NDArray[np.int64] | None, float]:
        """The best (J,) agents that were found with loads up to `most`, and the proven bound."""
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
    """(N,) what each agent has to do when jobs go to `chosen` (J,)."""
    loads_s = has_s.copy()
    np.add.at(loads_s, chosen, takes_s[np.arange(len(chosen)), chosen])
    return loads_s


def greedy(takes_s: Floats, has_s: Floats) -> NDArray[np.int64]:
    """(J,) agents: the longest job first, each to the one that is then done soonest."""
    loads_s, chosen = has_s.copy(), np.zeros(len(takes_s), np.int64)
    for job in np.argsort(-takes_s.min(axis=1), kind="stable"):
        chosen[job] = int((loads_s + takes_s[job]).argmin())
        loads_s[chosen[job]] += takes_s[job, chosen[job]]
    return chosen
