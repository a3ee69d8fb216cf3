"""Coordination: the phase of each agent, which is the number of its subgoal and whether it may go on.

While a policy acts, a coordinator gives both (`rf_exp.datagen.coordinator`). In demonstrations the subgoals
are stored, and waiting follows from the commands: an agent waits while its target stands still for some steps
and any agent still moves then or later.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.types import Scene, arm_of, gripper_of, joints_of, without_height

if TYPE_CHECKING:
    from rf_exp.store import Store

STILL_RAD = 1e-4  # a target that changes less in a control step stands still
GRIPPING_STEPS = 10  # after a gripper change, in which standing still is not waiting
SHORTEST_STEPS = 3  # of a wait

# Scene and last gripper commands by agent -> (N,) numbers of subgoals and (N,) whether agents may go on.
Coordinate = Callable[[Scene, Mapping[int, float]], tuple[NDArray[np.int64], NDArray[np.bool_]]]
SubgoalNames = tuple[tuple[str, ...], ...]  # names of the subgoals of each agent, by number


def numbered_subgoals(store: "Store") -> tuple[NDArray[np.int64], SubgoalNames]:
    """Subgoal numbers (T, N), the same for the same subgoal in all episodes, and the names of the subgoals.

    A store numbers the subgoals of an episode in their order. Where an agent has one more or one less than
    usual (draws aside, tries again), the numbers of those behind it would change. Names are empty where the
    stored numbers agree. Raises ArgumentError for a store without subgoals.
    """
    stored = store.subgoal[:].astype(np.int64)
    if (stored < 0).all():
        raise ArgumentError(f"{store.path} does not record the subgoals of its agents; generate it again")
    certificates = store.certificates
    if any("subgoals" not in certificate for certificate in certificates):
        return stored, ()  # older stores have no names
    episodes = [
        tuple(tuple(map(without_height, names)) for names in certificate["subgoals"])
        for certificate in certificates
    ]
    most_common = max(dict.fromkeys(episodes), key=episodes.count)
    names = tuple(
        tuple(
            dict.fromkeys([*most_common[agent], *(name for episode in episodes for name in episode[agent])])
        )
        for agent in range(len(most_common))
    )
    renumbered = stored.copy()
    for rows, names_of_agents in zip(store.by_episode(renumbered), episodes, strict=True):
        for agent, own_names in enumerate(names_of_agents):
            numbers = np.array([names[agent].index(name) for name in own_names])
            recorded = rows[:, agent] >= 0
            rows[recorded, agent] = numbers[rows[recorded, agent]]
    return (stored, ()) if np.array_equal(renumbered, stored) else (renumbered, names)


def phase_vectors(
    numbers: NDArray[np.integer], may_go: NDArray[np.bool_], subgoals: int
) -> NDArray[np.float32]:
    """Phases (..., N, subgoals + 1) from (..., N) each; numbers beyond the learned ones become the last."""
    one_hot = np.eye(subgoals)[np.minimum(numbers, subgoals - 1)]
    return np.concatenate([one_hot, may_go[..., None]], axis=-1).astype(np.float32)


def moving_target_mask(qpos: NDArray[np.floating], action: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) whether targets move in one episode with measured joints (T, N, 9) and commands (T, N, 8)."""
    previous = np.concatenate([joints_of(qpos[:1]), arm_of(action[:-1])])
    return np.abs(arm_of(action) - previous).max(axis=2) > STILL_RAD


def held_up_mask(action: NDArray[np.floating], executed: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) whether agents are held up in one episode, by intended and executed commands (T, N, 8).

    Meanwhile the executed command repeats, and the intended one is already that of the departure, but for the
    step before departure, where it is the present position (`rf_exp.coordination.intended`).
    """
    result = np.zeros(action.shape[:2], dtype=bool)
    moved = (np.diff(executed, axis=0) != 0).any(axis=2)  # (T - 1, N), of steps from 1 on
    for agent, column in enumerate(moved.T):
        departures = np.flatnonzero(column) + 1
        following = np.searchsorted(departures, np.arange(len(action)))  # the next one at or after each step
        departs = following < len(departures)
        departure = departures[following[departs]]
        unchanged = (action[departs, agent] == action[departure, agent]).all(axis=1)
        result[departs, agent] = unchanged & (departure > np.flatnonzero(departs))
        after_pause = departures[departures >= 2]
        after_pause = after_pause[~column[after_pause - 2]]  # stationary in the step before
        result[after_pause - 1, agent] |= result[after_pause - 2, agent]
    return result


def may_go_on_mask(
    qpos: NDArray[np.floating], action: NDArray[np.floating], executed: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """(T, N) whether agents may go on: joints (T, N, 9), intended and executed commands (T, N, 8) each."""
    busy = moving_target_mask(qpos, action) | held_up_mask(action, executed)
    changed = np.diff(gripper_of(action) > 0, axis=0, prepend=True)
    for delay in range(min(GRIPPING_STEPS, len(changed))):
        busy[delay:] |= changed[: len(changed) - delay]
    active_later = np.maximum.accumulate(np.any(busy, axis=1)[::-1])[::-1]  # any agent moves now or later
    result = busy | ~active_later[:, None]
    for column in result.T:
        for run in np.split(np.arange(len(column)), np.flatnonzero(np.diff(column)) + 1):
            if not column[run[0]] and len(run) < SHORTEST_STEPS:
                column[run] = True
    return result
