"""Remote policy: one on another machine, asked by openpi's protocol: msgpack over a websocket.

The server speaks first, with a map of what it likes to say of itself. Then each message is an observation,
and each answer a map with `actions`; a text in its place is an error of the server. The first observation
of an episode has `reset`, the seed of its scene: who keeps nothing between observations need not look.

Arrays travel in the form of openpi's `msgpack_numpy`: a map of the binary keys `__ndarray__` (true), `data`
(its bytes, C order), `dtype` (e.g. `<f4`) and `shape`; a NumPy number as one of `__npgeneric__`, `data` and
`dtype`. That client itself cannot be installed beside the NumPy of the suite. A server may use `pack` and
`unpack` of here: nothing else of the suite is needed.
"""

from contextlib import ExitStack
from typing import Any

import msgpack
import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI, WebSocketException
from websockets.sync.client import ClientConnection, connect

from rf_exp.errors import StageError
from rf_exp.texts import printable

LEAVE_S = 1.0  # how long a server may take to say goodbye
LARGEST = 2**24  # bytes of an answer; what is larger is no chunk of actions
ARRAY, NUMBER = b"__ndarray__", b"__npgeneric__"
KINDS = "biuf"  # of dtypes that travel: truth values and real numbers
LONGEST = 2**12  # items of one list or map; arrays travel as bytes, and are no such items
MOST = 2**16  # items of all lists and maps of a message: each costs many times the byte that announces it
KEYS, LAST = 5, 2000  # of an answer without actions that are repeated; characters at the end of an error


class Remote:
    """One connection, of one worker. Every way in which a server can fail raises a StageError."""

    def __init__(self, server: str, connect_s: float, answer_s: float) -> None:
        """Connects within `connect_s` seconds; each answer may take `answer_s`."""
        self._server, self._answer_s, self._open = server, answer_s, ExitStack()
        self._seed: int | None = None  # of an episode that has not begun yet
        try:
            self._socket: ClientConnection = self._open.enter_context(
                connect(
                    server,
                    open_timeout=connect_s,
                    close_timeout=LEAVE_S,
                    compression=None,
                    max_size=LARGEST,
                    ping_interval=None,  # who computes in the event loop of a server cannot answer them
                )
            )
        except TimeoutError as error:
            raise self._failed(f"does not answer within {connect_s:g} s (foreign.connect_s)") from error
        except (InvalidHandshake, InvalidURI) as error:
            how = f"refuses the connection: {printable(error)}; expected a websocket server"
            raise self._failed(how) from error
        except OSError as error:
            how = f"cannot be reached: {printable(error.strerror or error)}; start it first"
            raise self._failed(how) from error
        self.metadata = self._answer(connect_s, "foreign.connect_s")

    def reset(self, seed: int) -> None:
        """An episode begins; the server is told with its first observation."""
        self._seed = seed

    def act(self, observation: dict[str, Any]) -> Any:
        """The `actions` of the server for an observation."""
        begins = {} if self._seed is None else {"reset": self._seed}
        try:
            self._socket.send(pack({**observation, **begins}))
        except WebSocketException as error:
            raise self._failed(f"has closed the connection: {printable(error)}") from error
        self._seed = None
        answer = self._answer(self._answer_s, "foreign.answer_s")
        if "actions" not in answer:
            keys = [printable(key, 40) for key in list(answer)[:KEYS]]
            raise self._failed(f"answers with {sorted(keys)}; expected a map with 'actions'")
        return answer["actions"]

    def close(self) -> None:
        """Leaves the server."""
        self._open.close()

    def _answer(self, limit_s: float, key: str) -> dict[Any, Any]:
        try:
            said = self._socket.recv(limit_s)
        except TimeoutError as error:
            raise self._failed(f"gives no answer within {limit_s:g} s ({key})") from error
        except ConnectionClosed as error:
            raise self._failed(f"has closed the connection: {printable(error)}") from error
        if isinstance(said, str):
            last = (said[-LAST:].strip().splitlines() or ["nothing"])[-1]
            raise self._failed(f"reports an error: {printable(last)}")
        try:
            answer = unpack(said)
        except ValueError as error:
            how = f"answers with {printable(error)}; expected msgpack, as openpi's servers send"
            raise self._failed(how) from error
        if not isinstance(answer, dict):
            raise self._failed(f"answers with a {type(answer).__name__}; expected a map")
        return answer

    def _failed(self, how: str) -> StageError:
        self.close()
        return StageError(f"policy server {self._server} {how}")


def pack(value: Any) -> bytes:
    """Raises TypeError for what is neither an array of numbers nor something that msgpack knows."""
    packed = msgpack.packb(value, default=_encoded)
    assert packed is not None
    return packed


def unpack(data: bytes) -> Any:
    """What `pack` was given; arrays are new ones. Raises ValueError for anything else, or too much."""
    items = 0

    def counted(found: Any) -> Any:
        nonlocal items
        items += 1 + len(found)
        if items > MOST:
            raise ValueError(f"more than {MOST} items in lists and maps")
        return _restored(found) if isinstance(found, dict) else found

    limits = {"max_array_len": LONGEST, "max_map_len": LONGEST}
    try:
        return msgpack.unpackb(data, object_hook=counted, list_hook=counted, **limits)
    except (msgpack.UnpackException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{len(data)} bytes that are no message: {type(error).__name__}: {error}") from error


def _encoded(value: Any) -> dict[bytes, Any]:
    if not isinstance(value, np.ndarray | np.generic) or value.dtype.kind not in KINDS:
        raise TypeError(f"a {getattr(value, 'dtype', type(value).__name__)} cannot be sent")
    if isinstance(value, np.generic):
        return {NUMBER: True, b"data": value.item(), b"dtype": value.dtype.str}
    return {ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}


def _restored(found: dict[Any, Any]) -> Any:
    if ARRAY not in found and NUMBER not in found:
        return found
    dtype = np.dtype(found[b"dtype"])
    if dtype.kind not in KINDS:
        raise ValueError(f"an array of {dtype}")
    if NUMBER in found:
        return dtype.type(found[b"data"])
    return np.frombuffer(found[b"data"], dtype).reshape(found[b"shape"]).copy()
