"""What is said between RoboBrain and a language model, and the file that keeps it.

One file an episode, one JSON object a line, in the order of the calls:
`<folder>/<task>/<constraints>/<seed>.jsonl`. Pictures are kept as their SHA-256.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import dacite

from rf_exp.errors import StageError
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


@dataclass(frozen=True)
class Message:
    """One message to a model."""

    role: Literal["system", "user"]
    text: str
    pictures: Mapping[str, bytes] = field(default_factory=dict)  # camera -> JPEG


class Chat(Protocol):
    """Something that answers messages, live or from a recording."""

    def ask(self, purpose: str, messages: Sequence[Message], schema: Mapping[str, object]) -> str:
        """The text of the answer, wanted as JSON of that schema. Raises BadAnswer for no answer."""
        ...


@dataclass(frozen=True)
class Exchange:
    """One call and what came of it: a reply or an error."""

    call: int  # from 1, within the episode
    purpose: str  # propose | restate
    question_sha256: str
    messages: list[dict[str, object]]
    model: str
    reply: str | None
    error: str | None
    latency_s: float


def question_sha256(purpose: str, messages: Sequence[Message]) -> str:
    """Identifies a question by its text alone: pictures differ from one renderer to the next."""
    text = json.dumps([purpose, *((message.role, message.text) for message in messages)])
    return hashlib.sha256(text.encode()).hexdigest()


def without_pictures(message: Message) -> dict[str, object]:
    """The message as it is kept: each picture as its SHA-256."""
    hashes = {camera: hashlib.sha256(jpeg).hexdigest() for camera, jpeg in message.pictures.items()}
    return {"role": message.role, "text": message.text, "pictures_sha256": hashes}


def exchanges_path(folder: Path, task: Task, constraint_set: ConstraintSet, seed: int) -> Path:
    return folder / task.name / constraint_set.name / f"{seed}.jsonl"


def append(path: Path, exchange: Exchange) -> None:
    """Adds an exchange to its file; the first call of an episode begins the file anew."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w" if exchange.call == 1 else "a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(exchange)) + "\n")


def read(path: Path) -> tuple[Exchange, ...]:
    """The exchanges of an episode. Raises StageError for a line that is none."""
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            found.append(dacite.from_dict(Exchange, json.loads(line), dacite.Config(strict=True)))
        except (ValueError, TypeError, dacite.DaciteError) as error:
            raise StageError(f"{path}, line {number}: not a recorded exchange: {error}") from error
    return tuple(found)
