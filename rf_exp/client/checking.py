"""Checking a policy server: made-up observations of some episodes, and what is wrong with the answers."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .connection import Connection, ServerFailed
from .contract import CONTROL_HZ, JOINTS, SUITE, Contract, checked

EPISODES, ANSWERS = 2, 2  # of each, one connection
FAR_RAD = 0.5  # from where a joint is to its first target: ten steps at full speed


@dataclass(frozen=True)
class Report:
    """What a server did that the suite can use; `notes` is what it would alter, or what is odd."""

    metadata: dict[Any, Any]  # its greeting
    steps: tuple[int, ...]  # of each chunk
    seconds: tuple[float, ...]  # that each answer took
    notes: tuple[str, ...]


def check(server: str, contract: Contract, connect_s: float = 10.0, answer_s: float = 120.0) -> Report:
    """Asks a server as the suite does, for two answers in each of two episodes.

    Raises ServerFailed for one that cannot be reached, does not answer in time, or gives what the suite would
    refuse: it says which answer, and what is expected.
    """
    connection = Connection(server, connect_s, answer_s)
    steps, seconds, notes = [], [], dict[str, None]()
    try:
        for number in range(EPISODES * ANSWERS):
            episode, place = divmod(number, ANSWERS)
            if not place:
                connection.reset(episode)
            observation = contract.made_up(number)
            began = time.monotonic()
            answer = connection.act(observation)
            seconds.append(time.monotonic() - began)
            try:
                chunk = checked(answer, contract.arms)
            except ValueError as error:
                raise ServerFailed(f"answer {place + 1} of episode {episode + 1} holds {error}") from error
            steps.append(len(chunk))
            notes |= dict.fromkeys(oddities(chunk, observation.get("qpos")))
    finally:
        connection.close()
    return Report(connection.metadata, tuple(steps), tuple(seconds), tuple(notes))


def oddities(chunk: NDArray[np.float64], qpos: NDArray[np.float32] | None) -> Iterator[str]:
    """What is told of a chunk (T, N, 8) that the suite takes, where arms are as observed (N, 9)."""
    low, high = np.array(SUITE["limits_rad"])
    for row, targets in enumerate(chunk.swapaxes(0, 1)):  # (T, 8)
        agent = f"agent {row + 1}"
        joints, gripper = targets[:, :JOINTS], targets[:, JOINTS]
        if beyond := (np.flatnonzero(((joints < low) | (joints > high)).any(axis=0)) + 1).tolist():
            degrees = " (degrees?)" if np.abs(joints).max() > 2 * np.pi else ""
            yield f"{agent}: targets of joints {beyond} are beyond the Panda's limits{degrees}, and clipped"
        if np.abs(gripper).max() > 1:
            yield f"{agent}: its gripper is beyond [-1 (closed), 1 (open)], and clipped"
        elif gripper.min() >= 0 and gripper.max() <= 2 * SUITE["open_m"]:
            yield (
                f"{agent}: its gripper is told {gripper.min():.3g} to {gripper.max():.3g}, half open "
                "(metres?); expected -1 (closed) to 1 (open)"
            )
        if qpos is None:
            continue
        away = np.abs(joints[0] - qpos[row, :JOINTS])
        if away.max() > FAR_RAD:
            deltas = " (deltas? targets are absolute)" if np.abs(joints).max() < FAR_RAD else ""
            takes = away.max() / SUITE["step_rad"] / CONTROL_HZ
            yield (
                f"{agent}: the first target of joint {int(away.argmax()) + 1} is {away.max():.2f} rad from "
                f"where it is{deltas}; an arm needs {takes:.1f} s for that"
            )
