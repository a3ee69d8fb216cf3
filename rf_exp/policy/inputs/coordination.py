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
from rf_exp.types import Scene, arm_of, gripper_of, joints_of, what_of

if TYPE_CHECKING:
    from rf_exp.store import Store

STILL_RAD = 1e-4  # a target that changes less in a control step stands still
GRIPPING_STEPS = 10  # after a gripper change, in which standing still is not waiting
SHORTEST_STEPS = 3  # of a wait

# Scene and last gripper commands by agent -> (N,) numbers of subgoals and (N,) whether agents may go on.
Coordinate = Callable[[Scene, Mapping[int, float]], tuple[NDArray[np.int64], NDArray[np.bool_]]]
Names = tuple[tuple[str, ...], ...]  # names of the subgoals of each agent, by number


def numbered(store: "Store") -> tuple[NDArray[np.int64], Names]:
    """Subgoal numbers (T, N), the same for the same subgoal in all episodes, and the names of the subgoals.

    A store numbers the subgoals of an episode in their order. Where an agent has one more or one less than
    usual (draws aside, tries again), the numbers of those behind it would change. Names are empty where the
    stored numbers agree. Raises ArgumentError for a store without subgoals.
    """
    stored = store.subgoal[:].astype(np.int64)
    if (stored < 0).all():
        raise ArgumentError(f"{store.path} does not say who was at which subgoal; generate it again")
    certificates = store.certificates
    if any("subgoals" not in certificate for certificate in certificates):
        return stored, ()  # older stores have no names
    episodes = [tuple(tuple(map(what_of, texts)) for texts in each["subgoals"]) for each in certificates]
    usual = max(dict.fromkeys(episodes), key=episodes.count)
    names = tuple(
        tuple(dict.fromkeys([*usual[agent], *(text for texts in episodes for text in texts[agent])]))
        for agent in range(len(usual))
    )
    found = stored.copy()
    for rows, texts in zip(store.by_episode(found), episodes, strict=True):
        for agent, own in enumerate(texts):
            numbers = np.array([names[agent].index(text) for text in own])
            said = rows[:, agent] >= 0
            rows[said, agent] = numbers[rows[said, agent]]
    return (stored, ()) if np.array_equal(found, stored) else (found, names)


def phases(numbers: NDArray[np.integer], may_go: NDArray[np.bool_], subgoals: int) -> NDArray[np.float32]:
    """Phases (..., N, subgoals + 1) from (..., N) each; numbers beyond the learned ones become the last."""
    at = np.eye(subgoals)[np.minimum(numbers, subgoals - 1)]
    return np.concatenate([at, may_go[..., None]], axis=-1).astype(np.float32)


def sent_on(qpos: NDArray[np.floating], action: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) whether targets move in one episode with measured joints (T, N, 9) and commands (T, N, 8)."""
    before = np.concatenate([joints_of(qpos[:1]), arm_of(action[:-1])])
    return np.abs(arm_of(action) - before).max(axis=2) > STILL_RAD


def hesitates(action: NDArray[np.floating], executed: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) whether agents are held up in one episode, by intended and executed commands (T, N, 8).

    Meanwhile the executed command repeats, and the intended one is already that of the departure, but for the
    step before departure, where it is the present position (`rf_exp.coordination.intended`).
    """
    found = np.zeros(action.shape[:2], dtype=bool)
    moved = (np.diff(executed, axis=0) != 0).any(axis=2)  # (T - 1, N), of steps from 1 on
    for agent, column in enumerate(moved.T):
        leaves = np.flatnonzero(column) + 1
        of = np.searchsorted(leaves, np.arange(len(action)))  # the next departure at or after each step
        there = of < len(leaves)
        leave = leaves[of[there]]
        same = (action[there, agent] == action[leave, agent]).all(axis=1)
        found[there, agent] = same & (leave > np.flatnonzero(there))
        waited = leaves[leaves >= 2]
        waited = waited[~column[waited - 2]]  # stationary in the step before
        found[waited - 1, agent] |= found[waited - 2, agent]
    return found


def may_go(
    qpos: NDArray[np.floating], action: NDArray[np.floating], executed: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """(T, N) whether agents may go on: joints (T, N, 9), intended and executed commands (T, N, 8) each."""
    busy = sent_on(qpos, action) | hesitates(action, executed)
    changed = np.diff(gripper_of(action) > 0, axis=0, prepend=True)
    for late in range(min(GRIPPING_STEPS, len(changed))):
        busy[late:] |= changed[: len(changed) - late]
    later = np.maximum.accumulate(np.any(busy, axis=1)[::-1])[::-1]  # any agent moves now or later
    free = busy | ~later[:, None]
    for column in free.T:
        for stretch in np.split(np.arange(len(column)), np.flatnonzero(np.diff(column)) + 1):
            if not column[stretch[0]] and len(stretch) < SHORTEST_STEPS:
                column[stretch] = True
    return free
