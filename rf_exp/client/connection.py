"""Connection to a policy server, by openpi's protocol: msgpack over a websocket.

The server first sends a map of metadata. Then each message is an observation, and each answer a map with
`actions`; a text instead is an error of the server. The first observation of an episode has `reset`, the seed
of its scene, which stateless policies can ignore.
"""

from contextlib import ExitStack
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI, WebSocketException
from websockets.sync.client import ClientConnection, connect

from ..texts import printable
from .wire import LARGEST_BYTES, pack, unpack

# Closing may take a second. A server that computes in its event loop cannot answer pings.
CONNECT_OPTIONS: dict[str, Any] = {
    "close_timeout": 1,
    "compression": None,
    "max_size": LARGEST_BYTES,
    "ping_interval": None,
}
# Of an answer without actions; from the end of an error.
QUOTED_KEYS, QUOTED_CHARACTERS = 5, 2000


class ServerFailed(Exception):
    """Error: a policy server cannot be reached, does not answer, or gives an invalid answer."""


class Connection:
    """Connection to one policy server. Every failure of the server raises a ServerFailed that names it."""

    LIMITS = "connect_s", "answer_s"  # names of the limits in errors

    def __init__(self, server: str, connect_s: float, answer_s: float) -> None:
        """Connects to `ws://host:port` within `connect_s` seconds; each answer may take `answer_s`."""
        self._server, self._answer_s, self._resources = server, answer_s, ExitStack()
        self._seed: int | None = None  # of the episode that begins with the next observation
        try:
            connecting = connect(server, open_timeout=connect_s, **CONNECT_OPTIONS)
            self._socket: ClientConnection = self._resources.enter_context(connecting)
        except TimeoutError as error:
            raise self._failed(f"does not answer within {connect_s:g} s ({self.LIMITS[0]})") from error
        except (InvalidHandshake, InvalidURI) as error:
            how = f"refuses the connection: {printable(error)}; expected a websocket server"
            raise self._failed(how) from error
        except OSError as error:
            how = f"cannot be reached: {printable(error.strerror or error)}; start it first"
            raise self._failed(how) from error
        self.metadata = self._answer(connect_s, self.LIMITS[0])

    def reset(self, seed: int) -> None:
        """Begins an episode; its seed is sent with the first observation."""
        self._seed = seed

    def act(self, observation: dict[str, Any]) -> Any:
        """The `actions` of the server for an observation."""
        reset = {} if self._seed is None else {"reset": self._seed}
        try:
            self._socket.send(pack({**observation, **reset}))
        except WebSocketException as error:
            raise self._failed(f"has closed the connection: {printable(error)}") from error
        self._seed = None
        answer = self._answer(self._answer_s, self.LIMITS[1])
        if "actions" not in answer:
            keys = [printable(key, 40) for key in list(answer)[:QUOTED_KEYS]]
            raise self._failed(f"answers with {sorted(keys)}; expected a map with 'actions'")
        return answer["actions"]

    def close(self) -> None:
        """Closes the connection."""
        self._resources.close()

    def _answer(self, limit_s: float, key: str) -> dict[Any, Any]:
        try:
            message = self._socket.recv(limit_s)
        except TimeoutError as error:
            raise self._failed(f"gives no answer within {limit_s:g} s ({key})") from error
        except ConnectionClosed as error:
            raise self._failed(f"has closed the connection: {printable(error)}") from error
        if isinstance(message, str):
            last = (message[-QUOTED_CHARACTERS:].strip().splitlines() or ["nothing"])[-1]
            raise self._failed(f"reports an error: {printable(last)}")
        try:
            answer = unpack(message)
        except ValueError as error:
            how = f"answers with {printable(error)}; expected msgpack, as openpi's servers send"
            raise self._failed(how) from error
        if not isinstance(answer, dict):
            raise self._failed(f"answers with a {type(answer).__name__}; expected a map")
        return answer

    def _failed(self, how: str) -> Exception:
        """Closes the connection; returns the error to raise."""
        self.close()
        return ServerFailed(f"policy server {self._server} {how}")
