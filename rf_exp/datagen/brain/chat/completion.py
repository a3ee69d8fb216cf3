"""The text in a chat completion, whichever of its places a server puts it into."""

import json
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from rf_exp.datagen.brain.reading import BadAnswer
from rf_exp.texts import printable

MOST = 100  # choices, and calls of tools; a body of things that are none would be told of at great length


class _Function(BaseModel):
    arguments: str | dict[str, Any] | None = None


class _Call(BaseModel):
    function: _Function | None = None


class _Message(BaseModel):
    content: str | list[Any] | None = None
    refusal: str | None = None
    reasoning: Any = None
    reasoning_content: Any = None
    tool_calls: list[_Call] | None = Field(None, max_length=MOST, fail_fast=True)
    function_call: _Function | None = None


class _Choice(BaseModel):
    message: _Message
    finish_reason: str | None = None


class _Completion(BaseModel):
    """The part of a chat completion that matters; servers differ in the rest."""

    choices: list[_Choice] = Field(min_length=1, max_length=MOST, fail_fast=True)


def content(body: bytes, kind: str) -> str:
    """The model's text in a completion of that content type; what it thought, as `<think>`, where it wrote
    JSON there and nothing elsewhere. Raises BadAnswer that says why there is none.
    """
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
    thought = "\n".join(dict.fromkeys(_thoughts(message, parts)))
    if "{" in thought:
        return f"<think>{thought}"
    if thought.strip() or message.reasoning or message.reasoning_content:
        raise BadAnswer("the answer is thinking only: it has no text")
    others = sorted({printable(str(each.get("type")), 40) for each in parts if isinstance(each, dict)})
    raise BadAnswer(f"the answer is empty{', but for parts that are ' if others else ''}{', '.join(others)}")


def _thoughts(message: _Message, parts: list[Any]) -> Iterator[str]:
    """The texts in the places where servers put what a model thinks."""
    places = [message.reasoning_content, message.reasoning]
    places += [
        part.get("text") or part.get(kind)
        for part in parts
        if isinstance(part, dict) and (kind := part.get("type")) in ("reasoning", "thinking")
    ]
    return (each for each in places if isinstance(each, str))


def _text(part: object) -> str:
    """The text of a part of a message; pictures and thinking have none."""
    if isinstance(part, dict):
        kind, part = part.get("type", "text"), part.get("text")
        if kind not in ("text", "output_text"):
            return ""
    return part if isinstance(part, str) else ""
