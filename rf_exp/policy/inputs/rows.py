"""Rows of arms as policies use them: padded to seven joints, whatever the arm.

For an arm with fewer joints, zeros follow before its gripper, as in a task that also has an arm with more.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import ARM_JOINTS, FINGERS, Scene, narrowed

if TYPE_CHECKING:
    from rf_exp.store import Store

Number = TypeVar("Number", bound=np.generic)
GRIPPER = 1  # values of a command behind its joints


def wide(rows: NDArray[Number], hand: int) -> NDArray[Number]:
    """Rows (..., n + hand), padded to (..., ARM_JOINTS + hand); `hand` values follow the joints."""
    lacks = ARM_JOINTS + hand - rows.shape[-1]
    if lacks <= 0:
        return rows
    nothing = np.zeros((*rows.shape[:-1], lacks), rows.dtype)
    return np.concatenate([rows[..., :-hand], nothing, rows[..., -hand:]], axis=-1)


def narrow(commands: NDArray[Number], joints: int) -> NDArray[Number]:
    """Commands (..., 8), narrowed to (..., joints + 1) for a task whose arms have so many joints."""
    return narrowed(commands, joints, GRIPPER)


def measured(store: "Store") -> NDArray[np.float32]:
    """Measured joints (T, N, 9) of a store."""
    return wide(store.qpos, FINGERS)


def meant(store: "Store") -> NDArray[np.float32]:
    """Intended commands (T, N, 8) of a store."""
    return wide(store.action, GRIPPER)


def executed(store: "Store") -> NDArray[np.float32]:
    """Executed commands (T, N, 8) of a store."""
    return wide(store.executed, GRIPPER)


def widened(scene: Scene) -> Scene:
    """A scene with padded rows."""
    qpos, qvel = (wide(rows, FINGERS) for rows in (scene.qpos, scene.qvel))
    return scene if qpos is scene.qpos else replace(scene, qpos=qpos, qvel=qvel)
