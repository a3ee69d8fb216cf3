"""Whether a server holds the model to a JSON schema: one short request says so.

The question is one that nobody answers in that JSON of his own accord; the schema is that of real answers,
because servers differ in what they take of one.
"""

import asyncio
from dataclasses import dataclass, replace
from typing import Literal

from pydantic import ValidationError

from rf_exp.datagen.brain.chat.connection import Connection
from rf_exp.datagen.brain.chat.exchanges import Message
from rf_exp.datagen.brain.chat.request import request
from rf_exp.datagen.brain.protocol import strict_answer
from rf_exp.datagen.brain.reading import BadAnswer, Rejected, Unreached, read_object
from rf_exp.secrets import without
from rf_exp.tasks import Task
from rf_exp.texts import printable

_QUESTION = (
    Message("system", "The answer is as short as it can be. Whatever can be left empty is left empty."),
    Message("user", "There is nothing to do. Say so."),
)
Verdict = Literal["honoured", "ignored", "refused", "unreachable", "unknown"]


@dataclass(frozen=True)
class Probe:
    """What became of the schema, and the words to it."""

    verdict: Verdict
    found: str


def probe(connection: Connection, task: Task) -> Probe:
    """Asks once, with the schema of answers for the task, whatever `structured` says, and never again.

    Raises ArgumentError where a key is needed and there is none.
    """
    key, answer = connection.key(), strict_answer(task)
    asked = replace(connection, structured=True, retries=0)
    who = f"{connection.model} at {connection.address() or 'OpenAI'}"
    try:
        text = asyncio.run(request(asked, key, _QUESTION, answer.model_json_schema()))
    except BadAnswer as error:
        reason = without(str(error), key)
        if isinstance(error, Unreached):
            return Probe("unreachable", f"{who}: {reason}")
        if isinstance(error, Rejected):
            return Probe("refused", f"{who} refuses a request with the JSON schema: {reason}")
        return Probe("unknown", f"{who} answers, but not so that the JSON schema shows: {reason}")
    try:
        answer.model_validate(read_object(text, "Subgoals"))
    except (BadAnswer, ValidationError):
        begins = without(printable(text, 60), key)
        return Probe("ignored", f"{who} ignores the JSON schema; its answer begins {begins!r}")
    return Probe("honoured", f"{who} honours the JSON schema")
