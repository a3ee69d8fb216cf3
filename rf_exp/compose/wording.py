"""Rewording of a free request by a language model, as a sentence that the grammar understands.

The model only rewords: the grammar parses its sentence, and refuses it as it does a person's. The error is
returned to the model, which may try again while its budget of calls lasts.
"""

from collections.abc import Callable, Iterable
from typing import TypeVar

from rf_exp.compose.composing import parse_objects
from rf_exp.compose.sentence import FORMS, MAX_ARMS
from rf_exp.datagen.brain import BadAnswer, Chat, Message, bullet_list, fill_prompt, read_object
from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets
from rf_exp.texts import shown

KEY = "Sentence"
SCHEMA = {
    "type": "object",
    "properties": {KEY: {"type": "string"}},
    "required": [KEY],
    "additionalProperties": False,
}
MAX_REQUEST_LENGTH = 2000  # characters

Result = TypeVar("Result")


def reword(request: str, objects: Iterable[str], chat: Chat, make: Callable[[str], Result]) -> Result:
    """Result of `make` for the first sentence of the model that it does not refuse with an ArgumentError.

    Raises ArgumentError for a request that is too long, and for objects as `parse_objects` does, before any
    call; StageError where the model gives no answer, or none within its budget that is accepted.
    """
    if len(request) > MAX_REQUEST_LENGTH:
        raise ArgumentError(
            f"the sentence has {len(request)} characters; expected at most {MAX_REQUEST_LENGTH}"
        )
    descriptions = [
        _describe(name, spec["asset"], spec["options"]) for name, spec in parse_objects(objects).items()
    ]
    system = fill_prompt(
        "word", forms=bullet_list(FORMS), most=str(MAX_ARMS), things=bullet_list(descriptions)
    )
    attempts = list[str]()
    while True:
        text = "\n\n".join((f"What is wanted\n{shown(request, MAX_REQUEST_LENGTH)}", *attempts))
        answer = chat.ask("word", (Message("system", system), Message("user", text)), SCHEMA)
        try:
            return make(str(read_object(answer, KEY)[KEY]))
        except (ArgumentError, BadAnswer) as error:
            attempts.append(f"You said\n{shown(answer, MAX_REQUEST_LENGTH)}\nand it was refused\n{error}")


def _describe(name: str, kind: str, options: dict[str, object]) -> str:
    kinds = {point.kind for point in assets.load(kind, options).points.values()}
    uses = {"grasp": "can be moved", "place": "bears things", "drop": "holds things"}
    possible = ", ".join(use for point_kind, use in uses.items() if point_kind in kinds)
    return f"{name} ({kind}): {possible or 'stands'}"
