"""Policy server for the suite, by openpi's protocol: one thread per connection, one episode at a time."""

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

HOST, PORT = "127.0.0.1", 8000  # 0.0.0.0 to be reached from other machines; without authentication
INTERNAL_ERROR = 1011  # of the websocket protocol


class Policy(Protocol):
    """Protocol of a served policy. A stateful one also has `reset(seed)`, called as each episode begins."""

    def infer(self, observation: dict[str, Any]) -> Mapping[str, Any]:
        """`{"actions": chunk}`, (T, N, 8) or (T, N * 8), for an observation as `Contract` describes it."""
        ...


class Server:
    """Server that listens at `address`; `run` answers until `stop` is called."""

    def __init__(self, sockets: Sockets, host: str) -> None:
        self._sockets = sockets
        self.address = f"ws://{host}:{sockets.socket.getsockname()[1]}"

    def run(self) -> None:
        """Answers until stopped from another thread or by a keyboard interrupt."""
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
    """Yields a listening server of a policy, to be started with `run`; port 0 chooses a free one.

    A policy is shared by all connections, one call at a time; one that has `reset` belongs to one connection,
    and others are refused until it ends. A function without arguments makes a policy for each connection.
    `metadata` is sent as the greeting. An exception of a policy is sent to its client and ends only that
    connection.
    """
    per_connection = isinstance(policy, type) or not callable(getattr(policy, "infer", None))
    if per_connection and not callable(policy):
        raise TypeError(f"a {type(policy).__name__} without infer(observation); expected an object with it")
    policy_or_factory: Any = policy
    greeting = pack(dict(metadata or {}))
    inference_lock, policy_in_use = Lock(), Lock()

    def handle_connection(socket: ServerConnection) -> None:
        exclusive = not per_connection and hasattr(policy, "reset")
        if exclusive and not policy_in_use.acquire(blocking=False):
            return _send_error(
                socket,
                "this policy is stateful and already serves another connection; use workers=1",
            )
        try:
            own_policy = policy_or_factory() if per_connection else policy_or_factory
            socket.send(greeting)
            for message in socket:
                with inference_lock:
                    answer = _answer(own_policy, message)
                socket.send(answer)
        except ConnectionClosed:
            pass  # closed by the client
        except Exception:
            print(shown(traceback.format_exc()), file=sys.stderr)
            _send_error(socket, traceback.format_exc())
        finally:
            if exclusive:
                policy_in_use.release()

    # A client that simulates may not read for minutes; one that is gone longer releases its policy.
    timeouts: dict[str, Any] = {"ping_interval": 20, "ping_timeout": 600}
    with listen(handle_connection, host, port, max_size=None, compression=None, **timeouts) as sockets:
        yield Server(sockets, host)


def serve(
    policy: Policy | Callable[[], Policy],
    host: str = HOST,
    port: int = PORT,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Serves a policy until interrupted, and prints the address; arguments as of `serving`."""
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


def _send_error(socket: ServerConnection, error: str) -> None:
    """Sends an error, a text instead of an answer as in openpi, and closes the connection."""
    try:
        socket.send(error)
        socket.close(INTERNAL_ERROR)
    except ConnectionClosed:
        pass
