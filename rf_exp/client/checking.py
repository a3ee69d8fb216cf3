"""Check of a policy server: sends synthetic observations of some episodes and validates the answers."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .connection import Connection, ServerFailed
from .contract import CONTROL_HZ, JOINTS, SUITE, Contract, validate_chunk

EPISODES, ANSWERS = 2, 2  # answers per episode, over one connection
FAR_RAD = 0.5  # from a measured joint to its first target: ten steps at full speed


@dataclass(frozen=True)
class Report:
    """Valid answers of a server; `notes`: what the suite would change in them, and what is suspicious."""

    metadata: dict[Any, Any]  # the server's greeting
    steps: tuple[int, ...]  # of each chunk
    seconds: tuple[float, ...]  # duration of each answer
    notes: tuple[str, ...]


def check(server: str, contract: Contract, connect_s: float = 10.0, answer_s: float = 120.0) -> Report:
    """Queries a server as the suite does, for two answers in each of two episodes.

    Raises ServerFailed for a server that cannot be reached or does not answer in time, and for an answer that
    the suite would refuse, naming it and what is expected.
    """
    connection = Connection(server, connect_s, answer_s)
    steps, seconds, notes = [], [], dict[str, None]()
    try:
        for number in range(EPISODES * ANSWERS):
            episode, answer_number = divmod(number, ANSWERS)
            if not answer_number:
                connection.reset(episode)
            observation = contract.synthetic_observation(number)
            start = time.monotonic()
            answer = connection.act(observation)
            seconds.append(time.monotonic() - start)
            try:
                chunk = validate_chunk(answer, contract.arms)
            except ValueError as error:
                raise ServerFailed(
                    f"answer {answer_number + 1} of episode {episode + 1} holds {error}"
                ) from error
            steps.append(len(chunk))
            notes |= dict.fromkeys(chunk_warnings(chunk, observation.get("qpos")))
    finally:
        connection.close()
    return Report(connection.metadata, tuple(steps), tuple(seconds), tuple(notes))


def chunk_warnings(chunk: NDArray[np.float64], qpos: NDArray[np.float32] | None) -> Iterator[str]:
    """Suspicious features of a valid chunk (T, N, 8), given the observed joints (N, 9)."""
    low, high = np.array(SUITE["limits_rad"])
    for row, targets in enumerate(chunk.swapaxes(0, 1)):  # (T, 8)
        agent = f"agent {row + 1}"
        joints, gripper = targets[:, :JOINTS], targets[:, JOINTS]
        if beyond := (np.flatnonzero(((joints < low) | (joints > high)).any(axis=0)) + 1).tolist():
            hint = " (degrees?)" if np.abs(joints).max() > 2 * np.pi else ""
            yield f"{agent}: targets of joints {beyond} are beyond the Panda's limits{hint}, and clipped"
        if np.abs(gripper).max() > 1:
            yield f"{agent}: its gripper is beyond [-1 (closed), 1 (open)], and clipped"
        elif gripper.min() >= 0 and gripper.max() <= 2 * SUITE["open_m"]:
            yield (
                f"{agent}: its gripper commands are {gripper.min():.3g} to {gripper.max():.3g}, half open "
                "(metres?); expected -1 (closed) to 1 (open)"
            )
        if qpos is None:
            continue
        jumps = np.abs(joints[0] - qpos[row, :JOINTS])
        if jumps.max() > FAR_RAD:
            deltas_hint = " (deltas? targets are absolute)" if np.abs(joints).max() < FAR_RAD else ""
            needed_s = jumps.max() / SUITE["step_rad"] / CONTROL_HZ
            yield (
                f"{agent}: the first target of joint {int(jumps.argmax()) + 1} is {jumps.max():.2f} rad from "
                f"where it is{deltas_hint}; an arm needs {needed_s:.1f} s for that"
            )
