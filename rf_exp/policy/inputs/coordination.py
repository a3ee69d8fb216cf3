"""Coordination: what a policy is told of each own agent, the number of its subgoal, and whether it may go on.

While it acts a coordinator says so (`rf_exp.datagen.coordinator`). In demonstrations the stored subgoals say
the one, and the commands the other: an arm waits that is sent nowhere for a while, until nobody is any more.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.types import Scene, arm_of, gripper_of, joints_of, what_of

if TYPE_CHECKING:
    from rf_exp.store import Store

STILL_RAD = 1e-4  # less in a control step is no motion of a target
GRIPPING_STEPS = 10  # after a change of its gripper an arm stands still without waiting for anybody
SHORTEST_STEPS = 3  # of a wait

# Scene and last gripper commands by agent -> (N,) number of the subgoal and (N,) whether it may go on.
Coordinate = Callable[[Scene, Mapping[int, float]], tuple[NDArray[np.int64], NDArray[np.bool_]]]
Names = tuple[tuple[str, ...], ...]  # of the subgoals of each agent, in the order of their numbers


def numbered(store: "Store") -> tuple[NDArray[np.int64], Names]:
    """(T, N) the numbers of the subgoals, the same one for the same subgoal in all episodes, and their names.

    A store numbers them as they come. Where an agent now and then has one more or one less than usual (draws
    aside, tries again), those behind it would change their numbers. The names are empty where the stored
    numbers are the same ones. Raises ArgumentError for a store that does not say.
    """
    stored = store.subgoal[:].astype(np.int64)
    if (stored < 0).all():
        raise ArgumentError(f"{store.path} does not say who was at which subgoal; generate it again")
    certificates = store.certificates
    if any("subgoals" not in certificate for certificate in certificates):
        return stored, ()  # an older store does not name them
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
    """(..., N, subgoals + 1) of (..., N) each; numbers beyond those that were learned are the last one."""
    at = np.eye(subgoals)[np.minimum(numbers, subgoals - 1)]
    return np.concatenate([at, may_go[..., None]], axis=-1).astype(np.float32)


def sent_on(qpos: NDArray[np.floating], action: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) who is sent on in one episode with measured joints (T, N, 9) and commands (T, N, 8)."""
    before = np.concatenate([joints_of(qpos[:1]), arm_of(action[:-1])])
    return np.abs(arm_of(action) - before).max(axis=2) > STILL_RAD


def hesitates(action: NDArray[np.floating], executed: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(T, N) who stays in one episode though it means to go on: intended and executed commands (T, N, 8).

    It is told what it was told before, and means all the time what it does when it goes on at last, but for
    the step before that, in which its arm is meant to be where it stands (`rf_exp.coordination.intended`).
    """
    found = np.zeros(action.shape[:2], dtype=bool)
    moved = (np.diff(executed, axis=0) != 0).any(axis=2)  # (T - 1, N), of steps from 1 on
    for agent, column in enumerate(moved.T):
        leaves = np.flatnonzero(column) + 1
        of = np.searchsorted(leaves, np.arange(len(action)))  # the next departure after each step, or at it
        there = of < len(leaves)
        leave = leaves[of[there]]
        same = (action[there, agent] == action[leave, agent]).all(axis=1)
        found[there, agent] = same & (leave > np.flatnonzero(there))
        waited = leaves[leaves >= 2]
        waited = waited[~column[waited - 2]]  # it stood in the step before
        found[waited - 1, agent] |= found[waited - 2, agent]
    return found


def may_go(
    qpos: NDArray[np.floating], action: NDArray[np.floating], executed: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """(T, N) of one episode with measured joints (T, N, 9) and commands (T, N, 8), intended and executed."""
    busy = sent_on(qpos, action) | hesitates(action, executed)
    changed = np.diff(gripper_of(action) > 0, axis=0, prepend=True)
    for late in range(min(GRIPPING_STEPS, len(changed))):
        busy[late:] |= changed[: len(changed) - late]
    later = np.maximum.accumulate(np.any(busy, axis=1)[::-1])[::-1]  # somebody moves now or later
    free = busy | ~later[:, None]
    for column in free.T:
        for stretch in np.split(np.arange(len(column)), np.flatnonzero(np.diff(column)) + 1):
            if not column[stretch[0]] and len(stretch) < SHORTEST_STEPS:
                column[stretch] = True
    return free
