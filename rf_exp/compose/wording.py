"""Rewording of a free request by a language model, as a sentence that the grammar understands.

The model only rewords: the grammar parses its sentence, and refuses it as it does a person's. The error is
returned to the model, which may try again while its budget of calls lasts.
"""

from collections.abc import Callable, Iterable
from typing import TypeVar

from rf_exp.compose.composing import things_of
from rf_exp.compose.sentence import FORMS, MOST_ARMS
from rf_exp.datagen.brain import BadAnswer, Chat, Message, filled, listed, read_object
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
LONGEST_WISH = 2000  # characters

Made = TypeVar("Made")


def worded(wish: str, objects: Iterable[str], chat: Chat, make: Callable[[str], Made]) -> Made:
    """Result of `make` for the first sentence of the model that it does not refuse with an ArgumentError.

    Raises ArgumentError for a wish that is too long, and for objects as `things_of` does, before any call;
    StageError where the model gives no answer, or none within its budget that is accepted.
    """
    if len(wish) > LONGEST_WISH:
        raise ArgumentError(f"the sentence has {len(wish)} characters; expected at most {LONGEST_WISH}")
    things = [_told(name, spec["asset"], spec["options"]) for name, spec in things_of(objects).items()]
    system = filled("word", forms=listed(FORMS), most=str(MOST_ARMS), things=listed(things))
    tried = list[str]()
    while True:
        text = "\n\n".join((f"What is wanted\n{shown(wish, LONGEST_WISH)}", *tried))
        answer = chat.ask("word", (Message("system", system), Message("user", text)), SCHEMA)
        try:
            return make(str(read_object(answer, KEY)[KEY]))
        except (ArgumentError, BadAnswer) as error:
            tried.append(f"You said\n{shown(answer, LONGEST_WISH)}\nand it was refused\n{error}")


def _told(name: str, kind: str, options: dict[str, object]) -> str:
    kinds = {point.kind for point in assets.load(kind, options).points.values()}
    able = {"grasp": "can be moved", "place": "bears things", "drop": "holds things"}
    return f"{name} ({kind}): {', '.join(said for each, said in able.items() if each in kinds) or 'stands'}"
