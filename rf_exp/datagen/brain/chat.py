"""Dialogue with a language model: connection, messages, recorded exchanges, and their replay.

One file per episode, one JSON object per line, in the order of the calls:
`<folder>/<task>/<constraints>/<seed>.jsonl`. Pictures are recorded as their SHA-256.
"""

import asyncio
import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol

import dacite
from pydantic import Field, ValidationError

from rf_exp.artifacts import write_text
from rf_exp.datagen.brain.protocol import BadAnswer, read_object, strict_answer
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Finding
from rf_exp.secrets import SECRET_NAMES, check_address, check_environment_name, key_in_config_error, mask_key
from rf_exp.tasks import Task
from rf_exp.texts import printable
from rf_exp.types import ConstraintSet

_UNUSED_KEY = "none"  # sent to a server that needs no key
REQUEST_FIELDS = {  # field of every request -> where it is set
    "model": "brain.model",
    "messages": "the question",
    "response_format": "brain.structured",
    "temperature": "brain.temperature",
    "max_completion_tokens": "brain.max_tokens",
    "stream": "nobody, as answers are read whole",
}
_EXAMPLE_BODY = "{chat_template_kwargs: {enable_thinking: false}}"


@dataclass(frozen=True)
class Connection:
    """Model, server, and limits on time and calls, as in `conf/brain/openai.yaml`."""

    model: str
    base_url: str | None  # None: OPENAI_BASE_URL, or else OpenAI itself
    api_key_env: str  # environment variable that holds the key
    structured: bool  # request structured output by the JSON schema of the answer
    enumerated: bool  # list the legal subgoals and constraints of the scene in the schema
    temperature: float | None  # None: the server's default
    max_tokens: int  # of one answer
    extra_body: Any = field(hash=False)  # a mapping, the server's own options; None: none
    timeout_s: float  # of one request
    deadline_s: float  # of one call with all its retries and waits
    retries: int
    min_interval_s: float  # between the calls of one process
    budget: int  # calls for one episode

    def __post_init__(self) -> None:
        check_environment_name(self.api_key_env)
        if self.extra_body is not None:
            _check_extra_body(self.extra_body)
        if self.base_url is not None:
            check_address(self.base_url)
        if self.enumerated and not self.structured:
            raise ArgumentError(
                "brain.enumerated=true lists what may be said in the JSON schema, which is not sent with "
                "brain.structured=false; use brain.structured=true or brain.enumerated=false"
            )
        lowest = {"max_tokens": 1, "retries": 0, "min_interval_s": 0, "budget": 1}
        for name, low in lowest.items():
            if getattr(self, name) < low:
                raise ArgumentError(f"brain.{name} is {getattr(self, name)}; it must be at least {low}")
        for name in ("timeout_s", "deadline_s"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ArgumentError(f"brain.{name} is {getattr(self, name)}; it must be above 0 and finite")

    @property
    def sampling(self) -> dict[str, object]:
        """The sampling options that are recorded with every answer."""
        keys = ("temperature", "max_tokens", "structured", "enumerated")
        return {**{key: getattr(self, key) for key in keys}, **(self.extra_body or {})}

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
        return key or _UNUSED_KEY


def _check_extra_body(value: object) -> None:
    """Raises ArgumentError for anything but a JSON object of the server's own options without a key."""
    if not isinstance(value, Mapping):
        raise ArgumentError(
            f"brain.extra_body is {value!r}; expected a mapping of the server's options, e.g. {_EXAMPLE_BODY}"
        )
    if reserved := [name for name in value if name in REQUEST_FIELDS]:
        settings = ", ".join(f"{name} ({setting})" for name, setting in REQUEST_FIELDS.items())
        raise ArgumentError(
            f"brain.extra_body holds {reserved[0]!r}, which every request has already; set elsewhere: "
            f"{settings}; possible here are other options of the server, e.g. {_EXAMPLE_BODY}"
        )
    if secret_name := next((name for name in _nested_keys(value) if name.lower() in SECRET_NAMES), None):
        raise key_in_config_error(f"extra_body: {secret_name}")
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"brain.extra_body: {error}; expected values that JSON has") from None


def _nested_keys(value: object) -> Iterator[str]:
    """The keys of nested mappings."""
    if isinstance(value, Mapping):
        yield from map(str, value)
        value = [*value.values()]
    for item in value if isinstance(value, list) else ():
        yield from _nested_keys(item)


@dataclass(frozen=True)
class Message:
    """One message to a model."""

    role: Literal["system", "user"]
    text: str
    pictures: Mapping[str, bytes] = field(default_factory=dict)  # camera -> JPEG


@dataclass(frozen=True)
class Usage:
    """Tokens of an answer, as the server counts them."""

    prompt_tokens: Annotated[int, Field(ge=0)] = 0
    completion_tokens: Annotated[int, Field(ge=0)] = 0


class Chat(Protocol):
    """Source of answers to messages, live or from a recording."""

    exchanges: "list[Exchange]"  # in this episode

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        """The text of the answer, requested as JSON of that schema. Raises BadAnswer for no answer."""
        ...

    def record_verdicts(self, verdicts: Sequence[str]) -> None:
        """Called at the end with the outcomes of the proposals of the episode, in their order."""
        ...


@dataclass(frozen=True)
class Exchange:
    """One call with its reply or error, and RoboChecker's verdict on the reply."""

    call: int  # from 1, within the episode
    purpose: str  # propose | restate | word
    question_sha256: str
    messages: list[dict[str, object]]
    model: str
    reply: str | None
    error: str | None
    latency_s: float
    # Recordings of older versions lack the following fields.
    sampling: dict[str, object] = field(default_factory=dict)  # `Connection.sampling`
    finish_reason: str | None = None  # as reported by the server
    usage: Usage | None = None
    finding: Finding | None = None  # of an error
    verdict: str | None = None  # outcome of the proposal; None: it was none, or the run was aborted

    @property
    def answer(self) -> str:
        """The reply. Raises BadAnswer where there is none."""
        if self.reply is None:
            raise BadAnswer(str(self.error), self.finding or Finding.REFUSED)
        return self.reply


def question_sha256(purpose: str, messages: Sequence[Message]) -> str:
    """Hash that identifies a question by its text alone: pictures differ from one renderer to the next."""
    text = json.dumps([purpose, *((message.role, message.text) for message in messages)])
    return hashlib.sha256(text.encode()).hexdigest()


def without_pictures(message: Message) -> dict[str, object]:
    """The message as it is recorded: each picture as its SHA-256."""
    hashes = {camera: hashlib.sha256(jpeg).hexdigest() for camera, jpeg in message.pictures.items()}
    return {"role": message.role, "text": message.text, "pictures_sha256": hashes}


def exchanges_path(folder: Path, task: Task, constraint_set: ConstraintSet, seed: int) -> Path:
    return folder / task.name / constraint_set.name / f"{seed}.jsonl"


def read_exchanges(path: Path) -> tuple[Exchange, ...]:
    """The recorded exchanges of an episode. Raises StageError for an invalid line."""
    exchanges = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            exchanges.append(
                dacite.from_dict(Exchange, json.loads(line), dacite.Config(cast=[Finding], strict=True))
            )
        except (ValueError, TypeError, dacite.DaciteError) as error:
            raise StageError(f"{path}, line {number}: not a recorded exchange: {error}") from error
    return tuple(exchanges)


class OpenAIChat:
    """Dialogue of one episode with a model. `path`: file of its exchanges; None: they are not recorded."""

    _free_at_s: ClassVar[float] = 0.0  # earliest time of the next call of this process

    def __init__(self, connection: Connection, path: Path | None) -> None:
        self._connection, self._path = connection, path
        self._key = connection.key()
        self.exchanges: list[Exchange] = []

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        from rf_exp.datagen.brain.request import Received, request  # half a second, only for live models

        if len(self.exchanges) >= self._connection.budget:
            message = f"the model was not asked: the budget of {self._connection.budget} calls is used up"
            raise BadAnswer(message, Finding.SPENT)
        if (wait_s := OpenAIChat._free_at_s - time.monotonic()) > 0:
            time.sleep(wait_s)
        OpenAIChat._free_at_s = time.monotonic() + self._connection.min_interval_s
        start_s = time.perf_counter()
        try:
            received = asyncio.run(request(self._connection, self._key, messages, schema))
        except BadAnswer as failure:
            received = Received(failure)
        content = received.content
        exchange = Exchange(
            call=len(self.exchanges) + 1,
            purpose=purpose,
            question_sha256=question_sha256(purpose, messages),
            messages=[without_pictures(message) for message in messages],
            model=self._connection.model,
            reply=mask_key(content, self._key) if isinstance(content, str) else None,
            error=mask_key(str(content), self._key) if isinstance(content, BadAnswer) else None,
            latency_s=round(time.perf_counter() - start_s, 3),
            sampling=self._connection.sampling,
            finish_reason=received.finish_reason,
            usage=received.usage,
            finding=content.finding if isinstance(content, BadAnswer) else None,
        )
        self.exchanges.append(exchange)
        self._write()
        return exchange.answer

    def record_verdicts(self, verdicts: Sequence[str]) -> None:
        """Records the outcomes of the proposals of the episode, in their order."""
        proposals = [k for k, exchange in enumerate(self.exchanges) if exchange.purpose == "propose"]
        for k, verdict in zip(proposals, verdicts, strict=False):
            self.exchanges[k] = replace(self.exchanges[k], verdict=verdict)
        self._write()

    def _write(self) -> None:
        """Rewrites the file with the exchanges so far."""
        if self._path is not None:
            write_text(self._path, "".join(json.dumps(asdict(each)) + "\n" for each in self.exchanges))


class ReplayChat:
    """Replay that answers the k-th question of an episode as recorded, errors included."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recorded = read_exchanges(path) if path.exists() else None
        self.exchanges: list[Exchange] = []

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        """Raises BadAnswer without a recording, beyond its end, or for a question that differs from it."""
        if self._recorded is None:
            raise BadAnswer(f"there is no recording {self._path}")
        if len(self.exchanges) == len(self._recorded):
            raise BadAnswer(f"the recording {self._path} is over after {len(self._recorded)} calls")
        exchange = self._recorded[len(self.exchanges)]
        if exchange.question_sha256 != question_sha256(purpose, messages):
            raise BadAnswer(
                f"call {len(self.exchanges) + 1} asks another question than the recording {self._path}: "
                f"{_difference(exchange, purpose, messages)}"
            )
        self.exchanges.append(exchange)
        return exchange.answer

    def record_verdicts(self, verdicts: Sequence[str]) -> None:
        """Leaves the recording unchanged."""


def _difference(exchange: Exchange, purpose: str, messages: Sequence[Message]) -> str:
    """The first difference between the two questions, in words."""
    if exchange.purpose != purpose:
        return f"there {exchange.purpose!r}, now {purpose!r}"
    then = "\n".join(str(message.get("text", "")) for message in exchange.messages).splitlines()
    now = "\n".join(message.text for message in messages).splitlines()
    for old, new in zip(then, now, strict=False):
        if old != new:
            return f"there {old[:100]!r}, now {new[:100]!r}"
    return f"there {len(then)} lines, now {len(now)}"


_QUESTION = (  # no model answers it in the JSON of the schema unless held to it
    Message("system", "The answer is as short as it can be. Whatever can be left empty is left empty."),
    Message("user", "There is nothing to do. Say so."),
)
Verdict = Literal["honoured", "ignored", "refused", "unreachable", "unknown"]


@dataclass(frozen=True)
class Probe:
    """Result of `probe`: how the server treats the JSON schema, and a message about it."""

    verdict: Verdict
    message: str


def probe(connection: Connection, task: Task) -> Probe:
    """Sends one request with the schema of answers for the task, whatever `structured` is, without retries.

    The schema is that of real answers, as servers differ in which features of a schema they accept. Raises
    ArgumentError where a key is needed and there is none.
    """
    from rf_exp.datagen.brain.request import request

    key, answer = connection.key(), strict_answer(task)
    strict = replace(connection, structured=True, retries=0)
    server = f"{connection.model} at {connection.address() or 'OpenAI'}"
    try:
        text = asyncio.run(request(strict, key, _QUESTION, answer.model_json_schema())).text
    except BadAnswer as error:
        reason = mask_key(str(error), key)
        if error.finding is Finding.UNREACHED:
            return Probe("unreachable", f"{server}: {reason}")
        if error.finding is Finding.REJECTED:
            return Probe("refused", f"{server} refuses a request with the JSON schema: {reason}")
        return Probe("unknown", f"{server} answers, but not so that the JSON schema shows: {reason}")
    try:
        answer.model_validate(read_object(text, "Subgoals"))
    except (BadAnswer, ValidationError):
        beginning = printable(mask_key(text, key), 60)
        return Probe("ignored", f"{server} ignores the JSON schema; its answer begins {beginning!r}")
    return Probe("honoured", f"{server} honours the JSON schema")
