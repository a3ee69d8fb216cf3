"""Chat completion server on the loopback interface that can simulate misbehaviour."""

import json
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass(frozen=True)
class Reply:
    """One HTTP reply and how it is sent."""

    body: bytes
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    delay_s: float = 0.0  # before anything is sent
    cut_after: int | None = None  # bytes of the body, then the connection is closed
    drip_s: float = 0.0  # between single bytes of the body
    endless: bytes = b""  # sent repeatedly after the body


def completion(
    content: object,
    *,
    refusal: str | None = None,
    finish: str = "stop",
    more: Mapping[str, object] | None = None,
    **keywords,
) -> Reply:
    """A chat completion with a text, or parts, as content; `more` holds further fields of the message."""
    message = {"role": "assistant", "content": content, "refusal": refusal, **(more or {})}
    choice = {"index": 0, "message": message, "finish_reason": finish}
    body = {"id": "1", "object": "chat.completion", "created": 0, "model": "test", "choices": [choice]}
    return Reply(json.dumps(body).encode(), **keywords)


def failure(status: int, message: str, **headers: str) -> Reply:
    """An error reply in the format of the protocol."""
    return Reply(json.dumps({"error": {"message": message}}).encode(), status, headers)


class LanguageServer:
    """Server that answers the k-th request with the k-th reply, and further ones with the last reply."""

    def __init__(self, replies: Sequence[Reply] = ()) -> None:
        self.replies = list(replies)
        self.requests: list[dict[str, Any]] = []
        self.keys: list[str] = []
        self.times_s: list[float] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                outer.times_s.append(time.monotonic())
                content = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                outer.requests.append(json.loads(content or b"{}"))
                outer.keys.append(self.headers.get("Authorization", ""))
                self._send(outer.replies[min(len(outer.requests), len(outer.replies)) - 1])

            do_GET = do_POST  # a client may turn POST into GET after a redirect

            def _send(self, reply: Reply) -> None:
                self.close_connection = True
                if outer.closing.wait(reply.delay_s):
                    return
                self.send_response(reply.status)
                headers = {"Content-Type": "application/json", **reply.headers}
                for name, value in headers.items():
                    self.send_header(name, value)
                if not reply.endless:
                    self.send_header("Content-Length", str(len(reply.body)))
                self.end_headers()
                body = reply.body if reply.cut_after is None else reply.body[: reply.cut_after]
                if not reply.drip_s:
                    self.wfile.write(body)
                    while reply.endless and not outer.closing.is_set():
                        self.wfile.write(reply.endless)
                    return
                for byte in body:
                    if outer.closing.wait(reply.drip_s):
                        return
                    self.wfile.write(bytes([byte]))
                    self.wfile.flush()

            def log_message(self, format: str, *args: object) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, request: object, client_address: object) -> None:
                pass  # some tests close the connection early

        self.closing = threading.Event()
        self._server = Server(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02})

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_port}/v1"

    def __enter__(self) -> "LanguageServer":
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
