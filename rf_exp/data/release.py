"""What the authors' release calls tasks, arms and cameras, and what it tells its arms.

Its arms and cameras count from 0, where agents here count from 1; where there is one arm it numbers neither.
A command is seven joint targets in rad and a gripper from -1 closed to 1 open, at 20 Hz.
"""

import re

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT
from rf_exp.store import Store
from rf_exp.texts import printable
from rf_exp.types import narrowed

COMMAND = len(DEFAULT.told)  # numbers that tell an arm what to do
MEASURED = len(DEFAULT.measured)  # joints of an arm with its fingers
ROUNDING = 1e-5  # of a number that is at a limit
FARTHEST = np.pi  # beyond a limit, rad: what is farther off is no joint target

_TASK = re.compile(r"[a-z][a-z0-9_]{0,63}")
_THEIRS = re.compile(r"(head|hand)_cam(?:era)?_(?:agent)?(\d{1,2})")
_OURS = re.compile(r"(agent|hand)([1-9]\d?)")
_GLOBAL = "head_camera_global"


def checked_task(name: object) -> str:
    """The name of a task. Raises ArgumentError for one that cannot be."""
    if not isinstance(name, str) or not _TASK.fullmatch(name):
        raise ArgumentError(
            f"task is {printable(name)!r}; expected a name such as lift_barrier: small letters, digits and _"
        )
    return name


def environment(task: object) -> str:
    """`lift_barrier` -> `LiftBarrier-rf`. Raises ArgumentError for what is no name of a task."""
    task = task.replace("-", "_") if isinstance(task, str) else task  # before robots that are not the usual
    return "".join(word.capitalize() for word in checked_task(task).split("_")) + "-rf"


def task_of(name: str) -> str:
    """The task of `LiftBarrier-rf` and of what is named after it; empty where there is none."""
    camel, found, _ = name.partition("-rf")
    task = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", camel).lower()
    return task if found and _TASK.fullmatch(task) else ""


def camera_of(name: str, agents: int) -> str:
    """What a camera of the release is called here; a name of another kind stays."""
    if name in ("head_camera", "head_cam"):
        return "agent1" if agents == 1 else "global"  # one that serves all
    if name in (_GLOBAL, "head_cam_global"):
        return "global"
    found = _THEIRS.fullmatch(name)
    return f"{'agent' if found[1] == 'head' else 'hand'}{int(found[2]) + 1}" if found else name


def camera_name(camera: str, agents: int) -> str:
    """What the release calls a camera of ours."""
    if camera == "global":
        return _GLOBAL
    if camera == "agent1" and agents == 1:
        return "head_camera"
    found = _OURS.fullmatch(camera)
    if found is None:
        return camera
    return f"{'head_camera_agent' if found[1] == 'agent' else 'hand_camera_'}{int(found[2]) - 1}"


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
