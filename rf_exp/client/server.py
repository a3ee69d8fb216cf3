"""Serving a policy to the suite, by openpi's protocol: one thread a connection, each an episode at a time."""

import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Lock
from typing import Any, Protocol

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server as Sockets
from websockets.sync.server import ServerConnection
from websockets.sync.server import serve as listen

from ..texts import printable, shown
from .wire import pack, unpack

HOST, PORT = "127.0.0.1", 8000  # 0.0.0.0 to be reached from other machines; it asks nobody who they are
INTERNAL_ERROR = 1011  # of the websocket protocol


class Policy(Protocol):
    """What is served. One that remembers anything has `reset(seed)` too, called as each episode begins."""

    def infer(self, observation: dict[str, Any]) -> Mapping[str, Any]:
        """`{"actions": chunk}`, (T, N, 8) or (T, N * 8), for an observation as `Contract` describes it."""
        ...


class Server:
    """A policy that listens: `address` is where, `run` answers until `stop` is called."""

    def __init__(self, sockets: Sockets, host: str) -> None:
        self._sockets = sockets
        self.address = f"ws://{host}:{sockets.socket.getsockname()[1]}"

    def run(self) -> None:
        """Answers until it is stopped, from another thread or by the keyboard."""
        self._sockets.serve_forever()

    def stop(self) -> None:
        self._sockets.shutdown()


@contextmanager
def serving(
    policy: Policy | Callable[[], Policy],
    host: str = HOST,
    port: int = PORT,
    metadata: Mapping[str, Any] | None = None,
) -> Iterator[Server]:
    """A server of a policy, which listens and has yet to `run`; port 0 is one that is free.

    A policy is shared by all connections, one call at a time; one that has `reset` belongs to one connection,
    and the next is refused until it ends. A function without arguments makes each connection its own.
    `metadata` is what the suite is greeted with. What a policy raises is told to who asked, and ends that
    connection alone.
    """
    own = isinstance(policy, type) or not callable(getattr(policy, "infer", None))
    if own and not callable(policy):
        raise TypeError(f"a {type(policy).__name__} without infer(observation); expected an object with it")
    given: Any = policy
    greeting = pack(dict(metadata or {}))
    thinks, taken = Lock(), Lock()

    def converse(socket: ServerConnection) -> None:
        alone = not own and hasattr(policy, "reset")
        if alone and not taken.acquire(blocking=False):
            return _tell(
                socket, "this policy remembers its episode and answers somebody else; ask with workers=1"
            )
        try:
            mine = given() if own else given
            socket.send(greeting)
            for message in socket:
                with thinks:
                    answer = _answer(mine, message)
                socket.send(answer)
        except ConnectionClosed:
            pass  # by a worker that has ended
        except Exception:
            print(shown(traceback.format_exc()), file=sys.stderr)
            _tell(socket, traceback.format_exc())
        finally:
            if alone:
                taken.release()

    # Who simulates may not read for minutes; who is gone for longer holds no policy.
    waits: dict[str, Any] = {"ping_interval": 20, "ping_timeout": 600}
    with listen(converse, host, port, max_size=None, compression=None, **waits) as sockets:
        yield Server(sockets, host)


def serve(
    policy: Policy | Callable[[], Policy],
    host: str = HOST,
    port: int = PORT,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Serves a policy until it is interrupted, and prints where; arguments as of `serving`."""
    with serving(policy, host, port, metadata) as server:
        print(printable(f"policy server at {server.address}"), flush=True)
        server.run()


def _answer(policy: Any, message: str | bytes) -> bytes:
    if isinstance(message, str):
        raise ValueError("a message of text; expected an observation in msgpack")
    observation = unpack(message)
    seed = observation.pop("reset", None)
    if seed is not None and hasattr(policy, "reset"):
        policy.reset(seed)
    answer = policy.infer(observation)
    if not isinstance(answer, Mapping) or "actions" not in answer:
        raise TypeError(f"infer() answered with a {type(answer).__name__}; expected a map with 'actions'")
    return pack({**answer, "actions": np.asarray(answer["actions"])})


def _tell(socket: ServerConnection, error: str) -> None:
    """A text in the place of an answer is an error, as openpi tells of one."""
    try:
        socket.send(error)
        socket.close(INTERNAL_ERROR)
    except ConnectionClosed:
        pass
