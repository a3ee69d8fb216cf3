"""Which server, which model, and how much patience, as `conf/brain/openai.yaml` says, checked."""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from rf_exp.errors import ArgumentError
from rf_exp.secrets import SECRET, check_address, check_environment_name, no_key_here

_NO_KEY = "none"  # what a server that wants no key is sent
SENT = {  # by every request: what says it
    "model": "brain.model",
    "messages": "the question",
    "response_format": "brain.structured",
    "temperature": "brain.temperature",
    "max_completion_tokens": "brain.max_tokens",
    "stream": "nobody, as answers are read whole",
}
_EXAMPLE = "{chat_template_kwargs: {enable_thinking: false}}"


@dataclass(frozen=True)
class Connection:
    """Which model, where, and how much patience and how many calls it gets."""

    model: str
    base_url: str | None  # None: OPENAI_BASE_URL, or else OpenAI itself
    api_key_env: str  # environment variable that holds the key
    structured: bool  # hold the model to the JSON schema of the answer
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


def _check_extra_body(value: object) -> None:
    """Raises ArgumentError for what is no JSON object of the server's own options, or may hold a key."""
    if not isinstance(value, Mapping):
        raise ArgumentError(
            f"brain.extra_body is {value!r}; expected a mapping of the server's options, e.g. {_EXAMPLE}"
        )
    if taken := [name for name in value if name in SENT]:
        said = ", ".join(f"{name} ({by})" for name, by in SENT.items())
        raise ArgumentError(
            f"brain.extra_body holds {taken[0]!r}, which every request has already; said elsewhere: {said}; "
            f"possible here are other options of the server, e.g. {_EXAMPLE}"
        )
    if secret := next((name for name in _names(value) if name.lower() in SECRET), None):
        raise no_key_here(f"extra_body: {secret}")
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"brain.extra_body: {error}; expected values that JSON has") from None


def _names(value: object) -> Iterator[str]:
    """The keys of nested mappings."""
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    yield from map(str, value if isinstance(value, Mapping) else ())
    for each in inner:
        yield from _names(each)
