"""Task names and commands of the authors' release.

A command is seven joint targets in rad and a gripper value from -1 (closed) to 1 (open), at 20 Hz.
"""

import re

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT
from rf_exp.store import Store
from rf_exp.tasks import unmarked
from rf_exp.texts import printable
from rf_exp.types import narrowed

COMMAND = len(DEFAULT.told)  # size of a command
MEASURED = len(DEFAULT.measured)  # size of qpos: arm joints and fingers
ROUNDING = 1e-5  # tolerance for values at a limit
FARTHEST = np.pi  # rad beyond a limit; values farther off are not joint targets

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
        task = unmarked(task)[0].replace("-", "_")  # "-" precedes the names of other robots
    return "".join(word.capitalize() for word in checked_task(task).split("_")) + "-rf"


def task_of(name: str) -> str:
    """The task of `LiftBarrier-rf` and of names that begin so; empty for other names."""
    camel, found, _ = name.partition("-rf")
    task = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", camel).lower()
    return task if found and _TASK.fullmatch(task) else ""


def within_limits(told: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Commands (..., 8) clipped to their limits, and the largest excess, 0 up to `ROUNDING`.

    The release's own demonstrations exceed the joint limits in places.
    """
    low, high = np.append(DEFAULT.limits_rad, [[-1.0], [1.0]], axis=1).astype(np.float32)
    bounded = np.clip(told, low, high)
    beyond = float(np.abs(told - bounded).max(initial=0.0))
    return (bounded, beyond) if beyond > ROUNDING else (told, 0.0)


def own(store: Store, agent: int, rows: NDArray[np.float32], hand: int) -> NDArray[np.float32]:
    """Rows (..., n + hand) of an agent (0-based) without padding: arm joints, then `hand` gripper columns."""
    return narrowed(rows, len(store.models[agent].commands) - 1, hand)


def commands(store: Store, agent: int, rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Commands of one agent (0-based), (T, 8) for a Panda, from those of all agents (T, N, A)."""
    return own(store, agent, rows[:, agent], 1)
