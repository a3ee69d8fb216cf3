"""Gripper history: it counts changes and steps, but no failed grasp that is undone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rf_exp.policy.inputs.observation_spec import (
    EMPTY_OPENING_M,
    MOST_CHANGES,
    RECENT_STEPS,
    gripper_changes,
    gripper_histories,
)

OPEN_M, HELD_M = 0.08, 0.03
COMMANDS = st.lists(st.lists(st.sampled_from([1.0, -1.0, 0.3, -0.2]), min_size=2, max_size=2), min_size=1)


@given(commands=COMMANDS)
def test_the_history_counts_changes_and_steps(commands: list[list[float]]) -> None:
    found = gripper_histories(np.array(commands), np.full((len(commands), 2), HELD_M))
    for agent in range(2):
        opened, count, since = True, 0, RECENT_STEPS
        for row, command in zip(found, commands, strict=True):
            assert row[agent, :-1].argmax() == min(count, MOST_CHANGES) and row[agent, :-1].sum() == 1
            assert row[agent, -1] == pytest.approx(since / RECENT_STEPS)
            changed = (command[agent] > 0) != opened
            opened, count, since = (
                command[agent] > 0,
                count + changed,
                0 if changed else min(since + 1, RECENT_STEPS),
            )


@given(tries=st.lists(st.booleans(), min_size=1, max_size=5), waits=st.integers(1, 4))
def test_a_failed_grasp_that_is_undone_changes_nothing(tries: list[bool], waits: int) -> None:
    """Of several attempts to pick up an object and put it down again, only those count that held it."""
    commands, widths = [1.0], [OPEN_M]
    counted: list[int] = []
    for holds in tries:
        counted += [len(commands), len(commands) + waits] * holds
        commands += [-1.0] * waits + [1.0] * waits
        apart = HELD_M if holds else EMPTY_OPENING_M / 2
        widths += [OPEN_M, *[apart] * waits, *[OPEN_M] * (waits - 1)]  # fingers lag
    assert gripper_changes(np.array(commands), np.array(widths)).tolist() == counted
    memory = gripper_histories(np.array([[*commands, 1.0]]).T, np.array([[*widths, OPEN_M]]).T)
    assert memory[-1, 0, :-1].argmax() == min(MOST_CHANGES, 2 * sum(tries))


def test_a_gripper_that_stays_closed_on_nothing_has_changed() -> None:
    """For example one that pushes or strikes."""
    commands, widths = np.array([1.0, -1.0, -1.0, -1.0]), np.array([OPEN_M, OPEN_M, 0.0, 0.0])
    assert gripper_changes(commands, widths).tolist() == [1]
    assert gripper_histories(commands[:, None], widths[:, None])[-1, 0, :-1].argmax() == 1
