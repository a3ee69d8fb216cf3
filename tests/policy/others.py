"""Stub policies with their factories, and stub policy servers, for tests of foreign policies."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray
from websockets.sync.server import ServerConnection, serve

from rf_exp.client import pack

Answer = Callable[[dict[str, Any]], Any]


class Policy:
    """Policy that acts by a function and records its seeds and observations."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer
        self.seeds: list[int] = []
        self.observations: list[dict[str, Any]] = []

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)

    def act(self, observation: dict[str, Any]) -> Any:
        self.observations.append(observation)
        return self._answer(observation)


def stay(observation: dict[str, Any], steps: int = 5) -> NDArray[np.float32]:
    """Chunk (T, N, 8) that holds the measured joints, grippers open."""
    joints = observation["qpos"][:, :7]
    return np.tile(np.column_stack([joints, np.ones(len(joints), np.float32)]), (steps, 1, 1))


def make_stays(steps: int = 5) -> Policy:
    return Policy(lambda observation: stay(observation, steps))


def make_raises() -> Policy:
    raise RuntimeError("no checkpoint here")


def make_number() -> int:
    return 3


class Brittle(Policy):
    """Policy that holds still, but raises in the scene of `seed` until the file `mended` exists."""

    def __init__(self, seed: int, mended: str) -> None:
        super().__init__(stay)
        self._failing_seed, self._mended = seed, mended

    def act(self, observation: dict[str, Any]) -> Any:
        if self.seeds[-1] == self._failing_seed and not Path(self._mended).exists():
            raise ZeroDivisionError("broken")
        return super().act(observation)


make_brittle = Brittle


@contextmanager
def server(converse: Callable[[ServerConnection], None], **options: Any) -> Iterator[str]:
    """The address of a loopback server that handles each connection with `converse`."""
    with serve(converse, "127.0.0.1", 0, **options) as running:
        Thread(target=running.serve_forever, daemon=True).start()
        yield f"ws://127.0.0.1:{running.socket.getsockname()[1]}"
        running.shutdown()


def says(*messages: bytes | str) -> Callable[[ServerConnection], None]:
    """Handler: greets with the first message, answers with each of the next, and closes the connection."""

    def converse(socket: ServerConnection) -> None:
        socket.send(messages[0])
        for message in messages[1:]:
            socket.recv()
            socket.send(message)

    return converse


def silent(greets: bool) -> Callable[[ServerConnection], None]:
    """Handler that answers no request; with `greets`, it sends metadata first."""

    def converse(socket: ServerConnection) -> None:
        if greets:
            socket.send(pack({}))
        for _ in socket:
            pass

    return converse
