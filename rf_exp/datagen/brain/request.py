"""Request to a server with OpenAI's chat completions API; a slow import, only for live models.

Every failure becomes a BadAnswer, which the generation loop treats like any other failed proposal. Retries
and `Retry-After` are the client's own. A body is counted as received and again as decompressed, so that
neither an endless one nor a small one that decompresses to gigabytes is ever held in memory. Redirects are
not followed: the scene and the key go only to the configured address.
"""

import asyncio
import base64
import json
import zlib
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import httpx2
import openai
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from rf_exp.datagen.brain.chat import Connection, Message, Usage
from rf_exp.datagen.brain.protocol import BadAnswer
from rf_exp.findings import Finding
from rf_exp.texts import printable

_REJECTED_STATUSES = (400, 422, 501)  # HTTP statuses of a malformed or unsupported request
MAX_BODY_BYTES = 2**20  # received and decompressed; an answer of 4000 tokens has about 20 000
MAX_ITEMS = 100  # choices, and tool calls; otherwise a body of invalid ones gives a very long list of errors


@dataclass(frozen=True)
class Received:
    """A received completion, usable or not."""

    content: str | BadAnswer  # the model's text, or why there is none
    finish_reason: str | None = None
    usage: Usage | None = None  # None: not reported by the server

    @property
    def text(self) -> str:
        """The model's text. Raises BadAnswer where there is none."""
        if isinstance(self.content, BadAnswer):
            raise self.content
        return self.content


async def request(
    connection: Connection, key: str, messages: Sequence[Message], schema: Mapping[str, object]
) -> Received:
    """Requests a completion. The deadline also ends answers that trickle in for ever.

    Raises BadAnswer where no completion arrives. Text and error contain the key where the server repeats it.
    """
    # With the limits of the client, and proxies of the environment.
    http_client = openai.DefaultAsyncHttpxClient(
        follow_redirects=False, headers={"Accept-Encoding": "gzip"}, event_hooks={"response": [_limit_body]}
    )
    options: dict[str, Any] = {}
    if connection.structured:
        json_schema = {"name": "answer", "schema": schema, "strict": True}
        options["response_format"] = {"type": "json_schema", "json_schema": json_schema}
    if connection.temperature is not None:
        options["temperature"] = connection.temperature
    try:
        async with (
            asyncio.timeout(connection.deadline_s),
            openai.AsyncOpenAI(
                api_key=key,
                base_url=connection.address(),
                timeout=connection.timeout_s,
                max_retries=connection.retries,
                http_client=http_client,
            ) as client,
        ):
            response = await client.chat.completions.with_raw_response.create(
                model=connection.model,
                messages=[_api_message(message) for message in messages],
                max_completion_tokens=connection.max_tokens,
                extra_body=connection.extra_body,
                **options,
            )
            return parse_completion(response.content, response.headers.get("Content-Type", "no type"))
    except TimeoutError:
        message = f"the model did not answer within {connection.deadline_s:g} s"
        raise BadAnswer(message, Finding.UNREACHED) from None
    except openai.OpenAIError as error:
        raise _failure(error, connection) from None


def _failure(error: openai.OpenAIError, connection: Connection) -> BadAnswer:
    """The reason for a missing answer, in the words of the client or of the server."""
    finding, reason, cause = Finding.UNREACHED, printable(error), error.__cause__ or error
    if isinstance(error, openai.APITimeoutError):
        attempts = f"asked {connection.retries + 1} times"
        return BadAnswer(f"the model did not answer within {connection.timeout_s:g} s, {attempts}", finding)
    if isinstance(error, openai.RateLimitError):
        reason = f"too many requests ({reason})"
    elif isinstance(error, openai.APIStatusError):
        finding = Finding.REJECTED if error.status_code in _REJECTED_STATUSES else finding
        reason = f"the server answered {error.status_code} ({reason})"
    elif isinstance(error, openai.APIConnectionError):
        if isinstance(cause, BadAnswer):
            return cause
        reason = f"{type(cause).__name__} ({printable(cause)})"
    return BadAnswer(f"the model was not reached: {reason}", finding)


def _api_message(message: Message) -> Any:
    """The message in the format of the API, pictures as data URIs."""
    parts: list[dict[str, object]] = [{"type": "text", "text": message.text}]
    for camera, jpeg in message.pictures.items():
        uri = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        parts += [
            {"type": "text", "text": f"Camera {camera}:"},
            {"type": "image_url", "image_url": {"url": uri}},
        ]
    return {"role": message.role, "content": parts if message.pictures else message.text}


async def _limit_body(response: httpx2.Response) -> None:
    """Response hook that refuses redirects, and limits the body, also of an error, before it is read."""
    if response.has_redirect_location:
        raise BadAnswer(
            f"the model was not reached: the server answered {response.status_code} and sends on to "
            f"{printable(response.headers['Location'])!r}; no redirect is followed, so that the key goes to "
            "no other place; if that is the right one, give it as brain.base_url",
            Finding.UNREACHED,
        )
    encoding = response.headers.pop("Content-Encoding", "identity").strip().lower()
    if encoding not in ("gzip", "identity"):
        message = f"the answer is packed as {printable(encoding, 60)!r}; asked for was gzip or nothing"
        raise BadAnswer(message, Finding.NO_ANSWER)
    assert isinstance(response.stream, httpx2.AsyncByteStream)
    response.stream = _LimitedStream(response.stream, encoding == "gzip")
    response.encoding = "utf-8"  # whatever the server says: some of Python's codecs decompress, too


class _LimitedStream(httpx2.AsyncByteStream):
    """The decompressed bytes of a body. Raises BadAnswer once there are more than LARGEST_BODY."""

    def __init__(self, stream: httpx2.AsyncByteStream, gzip: bool) -> None:
        self._stream, self._gzip = stream, gzip

    async def __aiter__(self) -> AsyncIterator[bytes]:
        inflate = zlib.decompressobj(16 + zlib.MAX_WBITS) if self._gzip else None
        received = decompressed = 0
        async for chunk in self._stream:
            received += len(chunk)
            if inflate is not None:
                try:
                    chunk = inflate.decompress(chunk, MAX_BODY_BYTES - decompressed + 1)
                except zlib.error as error:
                    message = f"the answer cannot be unpacked: {error}"
                    raise BadAnswer(message, Finding.NO_ANSWER) from None
            decompressed += len(chunk)
            if max(received, decompressed) > MAX_BODY_BYTES:
                message = f"the answer is longer than {MAX_BODY_BYTES} bytes; the rest was not read"
                raise BadAnswer(message, Finding.CUT_OFF)
            yield chunk
        if inflate is not None and received and not inflate.eof:
            raise BadAnswer("the answer cannot be unpacked: it is cut off", Finding.CUT_OFF)

    async def aclose(self) -> None:
        await self._stream.aclose()


class _Function(BaseModel):
    arguments: str | dict[str, Any] | None = None


class _Call(BaseModel):
    function: _Function | None = None


class _Message(BaseModel):
    content: str | list[Any] | None = None
    refusal: str | None = None
    reasoning: Any = None
    reasoning_content: Any = None
    tool_calls: list[_Call] | None = Field(None, max_length=MAX_ITEMS, fail_fast=True)
    function_call: _Function | None = None


class _Choice(BaseModel):
    message: _Message
    finish_reason: str | None = None


class _Completion(BaseModel):
    """The fields of a chat completion that are read; servers differ in the others."""

    choices: list[_Choice] = Field(min_length=1, max_length=MAX_ITEMS, fail_fast=True)
    usage: Any = None


def parse_completion(body: bytes, content_type: str) -> Received:
    """Parses a chat completion of that content type. Raises BadAnswer for any other body."""
    try:
        completion = _Completion.model_validate_json(body)
    except ValidationError as error:
        message = f"the server's answer is not a chat completion: {error.errors()[0]['msg']}"
        beginning = printable(body[:60].decode("utf-8", "replace"))
        message = f"{message}; it is {printable(content_type, 60)} and begins {beginning!r}"
        raise BadAnswer(message, Finding.NO_ANSWER) from None
    choice = completion.choices[0]
    try:
        usage = TypeAdapter(Usage).validate_python(completion.usage)
    except ValidationError:
        usage = None  # servers report many things, or nothing
    return Received(_content(choice), choice.finish_reason, usage)


def _content(choice: _Choice) -> str | BadAnswer:
    """The model's text, or why there is none.

    Where a model has written JSON into its thinking and no other text, the thinking, as `<think>`.
    """
    message = choice.message
    parts = message.content if isinstance(message.content, list) else [message.content]
    refusals = [part.get("refusal") for part in parts if isinstance(part, dict)]
    if refusal := message.refusal or next(filter(None, refusals), None):
        return BadAnswer(f"the model refuses: {printable(refusal)}", Finding.DECLINED)
    if choice.finish_reason == "length":
        reason = "the answer is cut off: it reached brain.max_tokens before its end"
        return BadAnswer(reason, Finding.CUT_OFF)
    if choice.finish_reason == "content_filter":
        return BadAnswer("the answer is withheld by the server's content filter", Finding.DECLINED)
    functions = [call.function for call in message.tool_calls or ()] + [message.function_call]
    arguments = [function.arguments for function in functions if function is not None]
    texts = [each if isinstance(each, str) else json.dumps(each) for each in arguments if each]
    texts = texts or [text for part in parts if (text := _text(part))]
    if "".join(texts).strip():
        return "\n".join(texts)
    if arguments:
        return BadAnswer("the answer is a tool call without arguments", Finding.NO_ANSWER)
    thinking = "\n".join(dict.fromkeys(_thoughts(message, parts)))
    if "{" in thinking:
        return f"<think>{thinking}"
    if thinking.strip() or message.reasoning or message.reasoning_content:
        return BadAnswer("the answer is thinking only: it has no text", Finding.NO_ANSWER)
    others = sorted({printable(str(part.get("type")), 40) for part in parts if isinstance(part, dict)})
    reason = f"the answer is empty{', but for parts that are ' if others else ''}{', '.join(others)}"
    return BadAnswer(reason, Finding.NO_ANSWER)


def _thoughts(message: _Message, parts: list[Any]) -> Iterator[str]:
    """The texts in the fields where servers put a model's thinking."""
    fields = [message.reasoning_content, message.reasoning]
    fields += [
        part.get("text") or part.get(kind)
        for part in parts
        if isinstance(part, dict) and (kind := part.get("type")) in ("reasoning", "thinking")
    ]
    return (field for field in fields if isinstance(field, str))


def _text(part: object) -> str:
    """The text of a part of a message; empty for pictures and thinking."""
    if isinstance(part, dict):
        kind, part = part.get("type", "text"), part.get("text")
        if kind not in ("text", "output_text"):
            return ""
    return part if isinstance(part, str) else ""
