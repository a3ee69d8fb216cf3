"""Assignment of jobs to agents, compared with enumeration; jobs that no agent can do."""

from itertools import product

import numpy as np
import pytest

from rf_exp.coordination import assign


def random_durations_s(seed: int, jobs: int, agents: int) -> np.ndarray:
    """Random durations (J, N) in s, a third of them infinite, each job possible for at least one agent."""
    rng = np.random.default_rng(seed)
    durations_s = rng.uniform(2.0, 9.0, (jobs, agents))
    durations_s[rng.random((jobs, agents)) < 1 / 3] = np.inf
    durations_s[np.arange(jobs), rng.integers(agents, size=jobs)] = rng.uniform(2.0, 9.0, jobs)
    return durations_s.round(3)


@pytest.mark.parametrize("seed", range(12))
def test_no_assignment_has_a_smaller_largest_load_nor_less_work_with_it(seed: int) -> None:
    jobs, agents = (5, 3) if seed % 2 else (7, 2)
    durations_s, initial_loads_s = (
        random_durations_s(seed, jobs, agents),
        np.random.default_rng(seed).uniform(0, 5, agents).round(3),
    )
    found = assign(durations_s, initial_loads_s)
    assert found is not None and found.optimal
    assignments = []
    for chosen in product(range(agents), repeat=jobs):
        loads_s = [
            initial_loads_s[agent]
            + sum(durations_s[job, agent] for job, assigned in enumerate(chosen) if assigned == agent)
            for agent in range(agents)
        ]
        assignments.append((max(loads_s), sum(loads_s)))
    work_s = initial_loads_s.sum() + durations_s[np.arange(jobs), found.agents].sum()
    least_s = min(largest_s for largest_s, _ in assignments)
    assert found.largest_s == pytest.approx(least_s, rel=1e-9)
    best_s = min(total_s for largest_s, total_s in assignments if largest_s <= least_s + 1e-9)
    assert work_s == pytest.approx(best_s, rel=1e-9)


def test_the_bound_is_valid_where_the_search_ends_before_the_proof() -> None:
    """Twenty jobs of eight agents: the bound lies between a simple lower bound and the found solution."""
    durations_s = random_durations_s(3, 20, 8)
    found = assign(durations_s)
    assert found is not None
    lowest_s = max(durations_s.min(axis=1).max(), durations_s.min(axis=1).sum() / 8)
    assert lowest_s - 1e-3 <= found.bound_s <= found.largest_s + 1e-9


def test_an_impossible_job_is_not_assigned() -> None:
    durations_s = np.array([[1.0, 2.0], [np.inf, np.inf]])
    assert assign(durations_s) is None


def test_an_assignment_without_jobs() -> None:
    found = assign(np.empty((0, 2)), np.array([3.0, 1.0]))
    assert found is not None and found.agents == () and found.largest_s == found.bound_s == 3.0
