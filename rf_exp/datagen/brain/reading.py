"""The JSON in what a model wrote: bare, in prose, in fences, round or after its thinking, in a tool call.

Exactly one object is read. Where there is none, or where there are several, the error says what was found
instead, fit to be sent back as feedback.
"""

import json
import re
from collections.abc import Iterator
from typing import Any

from rf_exp.errors import StageError
from rf_exp.texts import printable

LONGEST_TEXT = 200_000  # characters; an answer has a few thousand
_DEEPEST = 4  # wrappers round an answer
_MOST_FAILURES = 16  # braces after which no JSON comes, until the search is given up
_BEGIN = 60  # characters of a text that are repeated
_THOUGHT = r"(?:think|thinking|thought|thoughts|reasoning|analysis|reflection)"
_OPENS, _CLOSES = re.compile(rf"<{_THOUGHT}>", re.IGNORECASE), re.compile(rf"</{_THOUGHT}>", re.IGNORECASE)
_OBJECT = re.compile(r'\{\s*(?:["}]|$)')
_REFUSES = re.compile(
    r"\W*(?:i(?:['\u2019]m| am) sorry|sorry|as an ai|"
    r"i (?:can(?:not|['\u2019]t)|am unable|won['\u2019]t|refuse))\b",
    re.IGNORECASE,
)


class BadAnswer(StageError):
    """No answer, or one that is not the paper's JSON or speaks of something that does not exist."""


class Unreached(BadAnswer):
    """The model was not asked: there is no way to it, the server is busy or broken, or wants another key."""


class Rejected(BadAnswer):
    """The server will not carry out the request as it is (status 400, 422 or 501)."""


def plain(key: str) -> str:
    """A key without what models vary: `Sub-goals` and `subgoals` are one."""
    return re.sub(r"[\W_]", "", key.casefold())


def read_object(text: str, key: str) -> dict[str, Any]:
    """The one JSON object with `key` in a text. Raises BadAnswer that says what there is instead."""
    if len(text) > LONGEST_TEXT:
        raise BadAnswer(f"the answer has {len(text)} characters; an answer has up to {LONGEST_TEXT}")
    thought, said = _parted(text)
    answers: list[dict[str, Any]] = []
    why = "it is empty"
    for part in (said, thought):
        objects, broken = _objects(part)
        answers = [answer for value in objects for answer in _holding(value, plain(key))]
        if answers or broken:
            why = broken
            break
        if objects:
            keys = ", ".join(printable(repr(name), 40) for name in list(objects[-1])[:5]) or "nothing"
            why = f"its JSON lacks {key!r}; it holds {keys}"
            break
        if part.strip():
            why = _without_json(part) if part is said else "it is thinking only, which no JSON follows"
            break
    if any(answer != answers[0] for answer in answers):
        raise BadAnswer(f"the answer holds {len(answers)} different objects with {key!r}; send one")
    if not answers:
        raise BadAnswer(f"the answer is not the expected JSON: {why}")
    if why:  # an answer beside something that is broken: which of them was meant?
        raise BadAnswer(f"the answer is not the expected JSON: beside a whole object, {why}")
    return answers[0]


def _parted(text: str) -> tuple[str, str]:
    """(what was thought, what was said). Templates leave out the first tag, or cut off before the last."""
    closed = [match.end() for match in _CLOSES.finditer(text)]
    if closed:
        return text[: closed[-1]], text[closed[-1] :]
    opened = _OPENS.search(text)
    return (text[opened.start() :], text[: opened.start()]) if opened else ("", text)


def _objects(text: str) -> tuple[list[dict[str, Any]], str]:
    """The outermost JSON objects in a text, and what is wrong with one that is none; empty for nothing."""
    found: list[dict[str, Any]] = []
    broken, at, failures = "", 0, 0
    while failures < _MOST_FAILURES and (match := _OBJECT.search(text, at)):
        try:
            value, at = _DECODER.raw_decode(text, match.start())
            found.append(value)
        except json.JSONDecodeError as error:
            # What lies within an object that is broken is a part of it, and no answer.
            cut_off = error.msg.startswith("Unterminated string") or not text[error.pos :].strip(" \t\r\n`")
            failures += 1
            broken = broken or ("it is cut off" if cut_off else f"{error.msg}, line {error.lineno}")
            at = len(text) if cut_off else max(error.pos, match.end())
        except RecursionError:
            return found, "it is nested too deeply"
        except ValueError as error:
            return found, str(error)
    return found, broken


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object none of whose keys is there twice, of which all but the last would be lost."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {printable(repr(twice), 40)} is there twice")
    return found


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")


_DECODER = json.JSONDecoder(object_pairs_hook=_once, parse_constant=_no_number, strict=False)


def _holding(value: object, key: str, depth: int = 0) -> Iterator[dict[str, Any]]:
    """The objects with the key: this one, or one that it wraps, as a tool call does."""
    if isinstance(value, dict) and any(plain(name) == key for name in value):
        yield value
    elif depth < _DEEPEST:
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        for each in inner:
            if isinstance(each, str) and isinstance(value, dict) and value.get("arguments") is each:
                for within in _objects(each)[0]:
                    yield from _holding(within, key, depth + 1)
            else:
                yield from _holding(each, key, depth + 1)


def _without_json(text: str) -> str:
    if _REFUSES.match(text):
        raise BadAnswer(f"the model refuses: {printable(text)}")
    return f"there is no JSON in it, only text that begins {printable(text, _BEGIN)!r}"
