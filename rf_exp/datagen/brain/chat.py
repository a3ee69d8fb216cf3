"""A language model behind any server that speaks OpenAI's chat completions.

Whatever goes wrong on the way becomes a BadAnswer, which the generation loop treats like any other
failed proposal. Connections, retries and `Retry-After` are the client's own.
"""

import asyncio
import base64
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import openai
from pydantic import BaseModel, Field, ValidationError

from rf_exp.datagen.brain import exchanges
from rf_exp.datagen.brain.bodies import connection
from rf_exp.datagen.brain.exchanges import Exchange, Message
from rf_exp.datagen.brain.reading import BadAnswer, printable
from rf_exp.datagen.brain.secrets import check_address, check_environment_name, without
from rf_exp.errors import ArgumentError

_NO_KEY = "none"  # what a server that wants no key is sent


@dataclass(frozen=True)
class Connection:
    """Which model, where, and how much patience and how many calls it gets."""

    model: str
    base_url: str | None  # None: OPENAI_BASE_URL, or else OpenAI itself
    api_key_env: str  # environment variable that holds the key
    structured: bool  # hold the model to the JSON schema of the answer
    temperature: float | None  # None: the server's default
    max_tokens: int  # of one answer
    timeout_s: float  # of one request
    deadline_s: float  # of one call with all its retries and waits
    retries: int
    min_interval_s: float  # between the calls of one process
    budget: int  # calls for one episode

    def __post_init__(self) -> None:
        check_environment_name(self.api_key_env)
        if self.base_url is not None:
            check_address(self.base_url)
        lowest = {"max_tokens": 1, "retries": 0, "min_interval_s": 0, "budget": 1}
        for name, low in lowest.items():
            if getattr(self, name) < low:
                raise ArgumentError(f"brain.{name} is {getattr(self, name)}; it must be at least {low}")
        for name in ("timeout_s", "deadline_s"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ArgumentError(f"brain.{name} is {getattr(self, name)}; it must be above 0 and finite")

    def address(self) -> str | None:
        """The server's address; None for OpenAI itself. Raises ArgumentError."""
        from_environment = os.environ.get("OPENAI_BASE_URL", "").strip()
        return self.base_url or (check_address(from_environment) if from_environment else None)

    def key(self) -> str:
        """The key in the environment. Raises ArgumentError where one is needed and there is none."""
        key = os.environ.get(self.api_key_env, "").strip()
        if not key and self.address() is None:
            raise ArgumentError(
                f"brain=openai needs a key in the environment variable {self.api_key_env}, or "
                "brain.base_url=ADDRESS of a server that wants none"
            )
        if not key.isascii() or not key.isprintable():
            raise ArgumentError(f"the key in the environment variable {self.api_key_env} is not plain ASCII")
        return key or _NO_KEY


class _Function(BaseModel):
    arguments: str | dict[str, Any] | None = None


class _Call(BaseModel):
    function: _Function | None = None


class _Message(BaseModel):
    content: str | list[Any] | None = None
    refusal: str | None = None
    reasoning: Any = None
    reasoning_content: Any = None
    tool_calls: list[_Call] | None = None
    function_call: _Function | None = None


class _Choice(BaseModel):
    message: _Message
    finish_reason: str | None = None


class _Completion(BaseModel):
    """The part of a chat completion that matters; servers differ in the rest."""

    choices: list[_Choice] = Field(min_length=1)


class OpenAIChat:
    """One episode's talk with a model. `path`: where its exchanges are kept, None for nowhere."""

    _free_at_s: ClassVar[float] = 0.0  # when this process may call again

    def __init__(self, connection: Connection, path: Path | None) -> None:
        self._connection, self._path = connection, path
        self._key, self._address = connection.key(), connection.address()
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
            reply = without(asyncio.run(self._request(messages, schema)), self._key)
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

    async def _request(self, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        """The model's text. The deadline also ends answers that trickle in for ever."""
        settings = self._connection
        options: dict[str, Any] = {}
        if settings.structured:
            wanted = {"name": "answer", "schema": schema, "strict": True}
            options["response_format"] = {"type": "json_schema", "json_schema": wanted}
        if settings.temperature is not None:
            options["temperature"] = settings.temperature
        try:
            async with (
                asyncio.timeout(settings.deadline_s),
                openai.AsyncOpenAI(
                    api_key=self._key,
                    base_url=self._address,
                    timeout=settings.timeout_s,
                    max_retries=settings.retries,
                    http_client=connection(),
                ) as client,
            ):
                response = await client.chat.completions.with_raw_response.create(
                    model=settings.model,
                    messages=[_wire(message) for message in messages],
                    max_completion_tokens=settings.max_tokens,
                    **options,
                )
                kind = response.headers.get("Content-Type", "no type")
                return _content(response.content, kind)
        except TimeoutError:
            raise BadAnswer(f"the model did not answer within {settings.deadline_s:g} s") from None
        except openai.APITimeoutError:
            raise BadAnswer(
                f"the model did not answer within {settings.timeout_s:g} s, "
                f"asked {settings.retries + 1} times"
            ) from None
        except openai.RateLimitError as error:
            raise BadAnswer(f"the model was not reached: too many requests ({printable(error)})") from None
        except openai.APIStatusError as error:
            raise BadAnswer(
                f"the model was not reached: the server answered {error.status_code} ({printable(error)})"
            ) from None
        except openai.APIConnectionError as error:
            cause = error.__cause__ or error
            if isinstance(cause, BadAnswer):
                raise cause from None
            raise BadAnswer(
                f"the model was not reached: {type(cause).__name__} ({printable(cause)})"
            ) from None
        except openai.OpenAIError as error:
            raise BadAnswer(f"the model was not reached: {printable(error)}") from None


def _wire(message: Message) -> Any:
    """The message as the protocol wants it, pictures as data URIs."""
    parts: list[dict[str, object]] = [{"type": "text", "text": message.text}]
    for camera, jpeg in message.pictures.items():
        uri = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        parts += [
            {"type": "text", "text": f"Camera {camera}:"},
            {"type": "image_url", "image_url": {"url": uri}},
        ]
    return {"role": message.role, "content": parts if message.pictures else message.text}


def _content(body: bytes, kind: str) -> str:
    """The model's text in a completion of that content type. Raises BadAnswer that says why there is none."""
    try:
        choice = _Completion.model_validate_json(body).choices[0]
    except ValidationError as error:
        begins = printable(body[:60].decode("utf-8", "replace"))
        raise BadAnswer(
            f"the server's answer is not a chat completion: {error.errors()[0]['msg']}; it is "
            f"{printable(kind, 60)} and begins {begins!r}"
        ) from None
    message = choice.message
    parts = message.content if isinstance(message.content, list) else [message.content]
    said = [each.get("refusal") for each in parts if isinstance(each, dict)]
    if refusal := message.refusal or next((each for each in said if each), None):
        raise BadAnswer(f"the model refuses: {printable(refusal)}")
    if choice.finish_reason == "length":
        raise BadAnswer("the answer is cut off: it reached brain.max_tokens before its end")
    if choice.finish_reason == "content_filter":
        raise BadAnswer("the answer is withheld by the server's content filter")
    called = [call.function for call in message.tool_calls or ()] + [message.function_call]
    found = [each.arguments for each in called if each is not None]
    texts = [each if isinstance(each, str) else json.dumps(each) for each in found if each]
    texts = texts or [text for each in parts if (text := _text(each))]
    if "".join(texts).strip():
        return "\n".join(texts)
    if found:
        raise BadAnswer("the answer is a tool call without arguments")
    if message.reasoning or message.reasoning_content:
        raise BadAnswer("the answer is thinking only: it has no text")
    others = sorted({printable(str(each.get("type")), 40) for each in parts if isinstance(each, dict)})
    raise BadAnswer(f"the answer is empty{', but for parts that are ' if others else ''}{', '.join(others)}")


def _text(part: object) -> str:
    """The text of a part of a message; pictures and thinking have none."""
    if isinstance(part, dict):
        kind, part = part.get("type", "text"), part.get("text")
        if kind not in ("text", "output_text"):
            return ""
    return part if isinstance(part, str) else ""
