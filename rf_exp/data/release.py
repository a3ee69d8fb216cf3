"""What the authors' release calls tasks, and what it tells its arms.

A command is seven joint targets in rad and a gripper from -1 closed to 1 open, at 20 Hz.
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

COMMAND = len(DEFAULT.told)  # numbers that tell an arm what to do
MEASURED = len(DEFAULT.measured)  # joints of an arm with its fingers
ROUNDING = 1e-5  # of a number that is at a limit
FARTHEST = np.pi  # beyond a limit, rad: what is farther off is no joint target

_TASK = re.compile(r"[a-z][a-z0-9_]{0,63}")


def checked_task(name: object) -> str:
    """The name of a task. Raises ArgumentError for one that cannot be."""
    if not isinstance(name, str) or not _TASK.fullmatch(name):
        raise ArgumentError(
            f"task is {printable(name)!r}; expected a name such as lift_barrier: small letters, digits and _"
        )
    return name


def environment(task: object) -> str:
    """`lift_barrier` -> `LiftBarrier-rf`. Raises ArgumentError for what is no name of a task."""
    if isinstance(task, str):
        task = unmarked(task)[0].replace("-", "_")  # before robots that are not the usual
    return "".join(word.capitalize() for word in checked_task(task).split("_")) + "-rf"


def task_of(name: str) -> str:
    """The task of `LiftBarrier-rf` and of what is named after it; empty where there is none."""
    camel, found, _ = name.partition("-rf")
    task = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", camel).lower()
    return task if found and _TASK.fullmatch(task) else ""


def within_limits(told: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Commands (..., 8) with every number within its bounds, and by how much one was beyond at most.

    The release's own demonstrations exceed the limits of joints in places.
    """
    low, high = np.append(DEFAULT.limits_rad, [[-1.0], [1.0]], axis=1).astype(np.float32)
    bounded = np.clip(told, low, high)
    beyond = float(np.abs(told - bounded).max(initial=0.0))
    return (bounded, beyond) if beyond > ROUNDING else (told, 0.0)


def own(store: Store, agent: int, rows: NDArray[np.float32], hand: int) -> NDArray[np.float32]:
    """Of rows (..., n + hand) of an agent, from 0 on, those of the joints of its arm, and of its hand."""
    return narrowed(rows, len(store.models[agent].commands) - 1, hand)


def commands(store: Store, agent: int, rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, 8) of a Panda, of commands (T, N, A) of all agents."""
    return own(store, agent, rows[:, agent], 1)
