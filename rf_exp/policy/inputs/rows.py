"""Rows of arms as policies use them: padded to seven joints, whatever the arm.

For an arm with fewer joints, zeros follow before its gripper, as in a task that also has an arm with more.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import ARM_JOINTS, FINGERS, Scene, without_padding

if TYPE_CHECKING:
    from rf_exp.store import Store

Number = TypeVar("Number", bound=np.generic)
GRIPPER = 1  # values of a command behind its joints


def with_padding(rows: NDArray[Number], gripper: int) -> NDArray[Number]:
    """Rows (..., n + gripper), padded to (..., ARM_JOINTS + gripper); `gripper` values follow the joints."""
    missing = ARM_JOINTS + gripper - rows.shape[-1]
    if missing <= 0:
        return rows
    padding = np.zeros((*rows.shape[:-1], missing), rows.dtype)
    return np.concatenate([rows[..., :-gripper], padding, rows[..., -gripper:]], axis=-1)


def unpadded_commands(commands: NDArray[Number], joints: int) -> NDArray[Number]:
    """Commands (..., 8), narrowed to (..., joints + 1) for a task whose arms have so many joints."""
    return without_padding(commands, joints, GRIPPER)


def measured_joints(store: "Store") -> NDArray[np.float32]:
    """Measured joints (T, N, 9) of a store."""
    return with_padding(store.qpos, FINGERS)


def intended_commands(store: "Store") -> NDArray[np.float32]:
    """Intended commands (T, N, 8) of a store."""
    return with_padding(store.action, GRIPPER)


def executed_commands(store: "Store") -> NDArray[np.float32]:
    """Executed commands (T, N, 8) of a store."""
    return with_padding(store.executed, GRIPPER)


def padded_scene(scene: Scene) -> Scene:
    """A scene with padded rows."""
    qpos, qvel = (with_padding(rows, FINGERS) for rows in (scene.qpos, scene.qvel))
    return scene if qpos is scene.qpos else replace(scene, qpos=qpos, qvel=qvel)
