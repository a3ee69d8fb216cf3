"""Rows of arms as policies have them: for seven joints, whatever arm it is.

Of an arm with fewer the last ones before its hand are zero, as beside another arm with more.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import ARM_JOINTS, FINGERS, Scene, narrowed

if TYPE_CHECKING:
    from rf_exp.store import Store

Number = TypeVar("Number", bound=np.generic)
GRIPPER = 1  # numbers of a command behind its joints


def wide(rows: NDArray[Number], hand: int) -> NDArray[Number]:
    """(..., ARM_JOINTS + hand) of rows (..., n + hand); what is so wide stays as it is."""
    lacks = ARM_JOINTS + hand - rows.shape[-1]
    if lacks <= 0:
        return rows
    nothing = np.zeros((*rows.shape[:-1], lacks), rows.dtype)
    return np.concatenate([rows[..., :-hand], nothing, rows[..., -hand:]], axis=-1)


def narrow(commands: NDArray[Number], joints: int) -> NDArray[Number]:
    """(..., joints + 1) for a task whose arms have so many, of commands (..., 8)."""
    return narrowed(commands, joints, GRIPPER)


def measured(store: "Store") -> NDArray[np.float32]:
    """(T, N, 9) the measured joints of a store."""
    return wide(store.qpos, FINGERS)


def meant(store: "Store") -> NDArray[np.float32]:
    """(T, N, 8) what its arms were meant to do."""
    return wide(store.action, GRIPPER)


def executed(store: "Store") -> NDArray[np.float32]:
    """(T, N, 8) what they were told."""
    return wide(store.executed, GRIPPER)


def widened(scene: Scene) -> Scene:
    """A scene with rows as policies have them."""
    qpos, qvel = (wide(rows, FINGERS) for rows in (scene.qpos, scene.qvel))
    return scene if qpos is scene.qpos else replace(scene, qpos=qpos, qvel=qvel)
