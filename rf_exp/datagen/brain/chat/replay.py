"""A recorded talk with a model, so that a run with one can be repeated anywhere."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rf_exp.datagen.brain.chat import exchanges
from rf_exp.datagen.brain.chat.exchanges import Message
from rf_exp.datagen.brain.protocol import BadAnswer


class ReplayChat:
    """Answers the k-th question of an episode as it was answered then, errors included."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recorded = exchanges.read(path) if path.exists() else None
        self._answered = 0

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        """Raises BadAnswer when nothing was recorded, when it is over, or for another question."""
        call = self._answered + 1
        if self._recorded is None:
            raise BadAnswer(f"there is no recording {self._path}")
        if call > len(self._recorded):
            raise BadAnswer(f"the recording {self._path} is over after {len(self._recorded)} calls")
        exchange = self._recorded[self._answered]
        if exchange.question_sha256 != exchanges.question_sha256(purpose, messages):
            raise BadAnswer(
                f"call {call} asks another question than the recording {self._path}: "
                f"{_difference(exchange, purpose, messages)}"
            )
        self._answered = call
        if exchange.reply is None:
            raise BadAnswer(str(exchange.error))
        return exchange.reply


def _difference(exchange: exchanges.Exchange, purpose: str, messages: Sequence[Message]) -> str:
    """Where the two questions part, in words."""
    if exchange.purpose != purpose:
        return f"there {exchange.purpose!r}, now {purpose!r}"
    then = "\n".join(str(message.get("text", "")) for message in exchange.messages).splitlines()
    now = "\n".join(message.text for message in messages).splitlines()
    for old, new in zip(then, now, strict=False):
        if old != new:
            return f"there {old[:100]!r}, now {new[:100]!r}"
    return f"there {len(then)} lines, now {len(now)}"
