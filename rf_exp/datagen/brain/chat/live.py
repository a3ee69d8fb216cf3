"""One episode's talk with a language model: its budget of calls, its pace, and the file that keeps it."""

import asyncio
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from rf_exp.datagen.brain.chat import exchanges
from rf_exp.datagen.brain.chat.connection import Connection
from rf_exp.datagen.brain.chat.exchanges import Exchange, Message
from rf_exp.datagen.brain.chat.request import request
from rf_exp.datagen.brain.reading import BadAnswer
from rf_exp.secrets import without


class OpenAIChat:
    """One episode's talk with a model. `path`: where its exchanges are kept, None for nowhere."""

    _free_at_s: ClassVar[float] = 0.0  # when this process may call again

    def __init__(self, connection: Connection, path: Path | None) -> None:
        self._connection, self._path = connection, path
        self._key = connection.key()
        self._calls = 0

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        if self._calls >= self._connection.budget:
            raise BadAnswer(
                f"the model was not asked: the budget of {self._connection.budget} calls is used up"
            )
        self._calls += 1
        self._wait_turn()
        began = time.perf_counter()
        reply = error = None
        try:
            reply = without(asyncio.run(request(self._connection, self._key, messages, schema)), self._key)
        except BadAnswer as failure:
            error = without(str(failure), self._key)
        if self._path is not None:
            exchange = Exchange(
                call=self._calls,
                purpose=purpose,
                question_sha256=exchanges.question_sha256(purpose, messages),
                messages=[exchanges.without_pictures(message) for message in messages],
                model=self._connection.model,
                reply=reply,
                error=error,
                latency_s=round(time.perf_counter() - began, 3),
            )
            exchanges.append(self._path, exchange)
        if reply is None:
            raise BadAnswer(str(error))
        return reply

    def _wait_turn(self) -> None:
        now_s = time.monotonic()
        if OpenAIChat._free_at_s > now_s:
            time.sleep(OpenAIChat._free_at_s - now_s)
        OpenAIChat._free_at_s = time.monotonic() + self._connection.min_interval_s
