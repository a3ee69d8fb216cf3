"""Jobs to agents: against enumeration, and what nobody can do."""

from itertools import product

import numpy as np
import pytest

from rf_exp.coordination import assign


def drawn(seed: int, jobs: int, agents: int) -> np.ndarray:
    """(J, N) s, a third of it out of reach, each job in reach of one agent at least."""
    rng = np.random.default_rng(seed)
    takes_s = rng.uniform(2.0, 9.0, (jobs, agents))
    takes_s[rng.random((jobs, agents)) < 1 / 3] = np.inf
    takes_s[np.arange(jobs), rng.integers(agents, size=jobs)] = rng.uniform(2.0, 9.0, jobs)
    return takes_s.round(3)


@pytest.mark.parametrize("seed", range(12))
def test_no_assignment_has_a_smaller_largest_load_nor_less_work_with_it(seed: int) -> None:
    jobs, agents = (5, 3) if seed % 2 else (7, 2)
    takes_s, has_s = drawn(seed, jobs, agents), np.random.default_rng(seed).uniform(0, 5, agents).round(3)
    found = assign(takes_s, has_s)
    assert found is not None and found.optimal
    every = []
    for chosen in product(range(agents), repeat=jobs):
        loads_s = [
            has_s[agent] + sum(takes_s[job, agent] for job, who in enumerate(chosen) if who == agent)
            for agent in range(agents)
        ]
        every.append((max(loads_s), sum(loads_s)))
    work_s = has_s.sum() + takes_s[np.arange(jobs), found.agents].sum()
    least_s = min(largest_s for largest_s, _ in every)
    assert found.largest_s == pytest.approx(least_s, rel=1e-9)
    best_s = min(total_s for largest_s, total_s in every if largest_s <= least_s + 1e-9)
    assert work_s == pytest.approx(best_s, rel=1e-9)


def test_the_bound_holds_where_the_search_ends_before_the_proof() -> None:
    """Twenty jobs of eight agents: the bound is no more than what one long search has found."""
    takes_s = drawn(3, 20, 8)
    found = assign(takes_s)
    assert found is not None
    lowest_s = max(takes_s.min(axis=1).max(), takes_s.min(axis=1).sum() / 8)
    assert lowest_s - 1e-3 <= found.bound_s <= found.largest_s + 1e-9


def test_what_nobody_can_do_is_not_assigned() -> None:
    takes_s = np.array([[1.0, 2.0], [np.inf, np.inf]])
    assert assign(takes_s) is None


def test_nothing_to_do() -> None:
    found = assign(np.empty((0, 2)), np.array([3.0, 1.0]))
    assert found is not None and found.agents == () and found.largest_s == found.bound_s == 3.0
