"""Task names and commands of the authors' release.

A command is seven joint targets in rad and a gripper value from -1 (closed) to 1 (open), at 20 Hz.
"""

import re

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT
from rf_exp.store import Store
from rf_exp.tasks import split_marks
from rf_exp.texts import printable
from rf_exp.types import without_padding

COMMAND_SIZE = len(DEFAULT.command_names)  # size of a command
QPOS_SIZE = len(DEFAULT.qpos_names)  # size of qpos: arm joints and fingers
ROUNDING = 1e-5  # tolerance for values at a limit
MAX_EXCESS_RAD = np.pi  # rad beyond a limit; values farther off are not joint targets

_TASK = re.compile(r"[a-z][a-z0-9_]{0,63}")


def checked_task(name: object) -> str:
    """The name of a task. Raises ArgumentError for an invalid one."""
    if not isinstance(name, str) or not _TASK.fullmatch(name):
        raise ArgumentError(
            f"task is {printable(name)!r}; expected a name such as lift_barrier: small letters, digits and _"
        )
    return name


def environment(task: object) -> str:
    """`lift_barrier` -> `LiftBarrier-rf`, the release's ID. Raises ArgumentError for an invalid name."""
    if isinstance(task, str):
        task = split_marks(task)[0].replace("-", "_")  # "-" precedes the names of other robots
    return "".join(word.capitalize() for word in checked_task(task).split("_")) + "-rf"


def task_of(name: str) -> str:
    """The task of `LiftBarrier-rf` and of names that begin so; empty for other names."""
    camel_case, suffix, _ = name.partition("-rf")
    task = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", camel_case).lower()
    return task if suffix and _TASK.fullmatch(task) else ""


def within_limits(commands: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Commands (..., 8) clipped to their limits, and the largest excess, 0 up to `ROUNDING`.

    The release's own demonstrations exceed the joint limits in places.
    """
    low, high = np.append(DEFAULT.limits_rad, [[-1.0], [1.0]], axis=1).astype(np.float32)
    clipped = np.clip(commands, low, high)
    excess = float(np.abs(commands - clipped).max(initial=0.0))
    return (clipped, excess) if excess > ROUNDING else (commands, 0.0)


def arm_columns(
    store: Store, agent: int, rows: NDArray[np.float32], gripper_size: int
) -> NDArray[np.float32]:
    """Rows (..., n + gripper_size) of an agent (0-based) without padding: arm joints, then gripper."""
    return without_padding(rows, len(store.models[agent].commands) - 1, gripper_size)


def agent_commands(store: Store, agent: int, rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Commands of one agent (0-based), (T, 8) for a Panda, from those of all agents (T, N, A)."""
    return arm_columns(store, agent, rows[:, agent], 1)
