"""The RoboBrain that is a language model, live or from a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rf_exp.artifacts import without
from rf_exp.datagen.brain.chat.connection import Connection
from rf_exp.datagen.brain.chat.exchanges import Chat, exchanges_path
from rf_exp.datagen.brain.chat.live import OpenAIChat
from rf_exp.datagen.brain.chat.replay import ReplayChat
from rf_exp.datagen.brain.protocol import BadAnswer, Question, from_json, strict_answer, to_json
from rf_exp.datagen.brain.sight import Sight
from rf_exp.errors import ArgumentError
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


class LanguageBrain:
    """Puts the scene into words, asks, and has unclear constraints restated."""

    def __init__(self, name: str, chat: Chat, *, sight: Sight | None, restates: bool) -> None:
        self.name = name
        self._chat, self._sight, self._restates = chat, sight, restates

    def answer(self, question: Question) -> str:
        # Slow to import for who asks no model.
        from rf_exp.datagen.brain.matching import restate
        from rf_exp.datagen.brain.questions import messages

        task = question.task
        schema = strict_answer(task).model_json_schema()
        text = self._chat.ask("propose", messages(question, self._sight), schema)
        if not self._restates:
            return text
        try:
            proposal = from_json(text, task)
        except BadAnswer:
            return text  # the loop says what is wrong with it
        return to_json(restate(proposal, task, self._chat))


@dataclass(frozen=True)
class OpenAISpec(Connection):
    """`brain=openai`: any server that speaks chat completions."""

    name: ClassVar[str] = "openai"
    reads: ClassVar[bool] = True

    pictures: bool  # send them
    cameras: str  # those of which: all | local | global
    picture_px: int | None  # longer side of them; None: as the cameras take them
    restate: bool  # have constraints restated that the grammar does not understand
    exchanges: Path | None  # folder for what was said; None: it is not kept

    def __post_init__(self) -> None:
        super().__post_init__()
        Sight(self.cameras, self.picture_px)  # raises ArgumentError, also where no pictures are sent

    @property
    def sight(self) -> Sight | None:
        """What the model is shown; None: nothing."""
        return Sight(self.cameras, self.picture_px) if self.pictures else None

    @property
    def identity(self) -> dict[str, object]:
        """What decides the answers; patience and budget are none of it."""
        keys = ("model", "base_url", "structured", "temperature", "max_tokens", "pictures", "restate")
        said = {key: getattr(self, key) for key in (*keys, "extra_body", "cameras", "picture_px")}
        return {"name": self.name, **without(said, extra_body=None, cameras="all", picture_px=None)}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> LanguageBrain:
        path = exchanges_path(self.exchanges, task, constraint_set, seed) if self.exchanges else None
        chat = OpenAIChat(self, path)
        return LanguageBrain(self.name, chat, sight=self.sight, restates=self.restate)

    def again(self) -> "OpenAISpec | ReplaySpec":
        """The same answers once more, without asking where they were kept."""
        return ReplaySpec(self.exchanges, self.restate) if self.exchanges else self


@dataclass(frozen=True)
class ReplaySpec:
    """`brain=replay`: recorded exchanges."""

    name: ClassVar[str] = "replay"
    reads: ClassVar[bool] = True

    exchanges: Path  # folder, as `brain=openai` left it
    restate: bool  # as in the run that was recorded

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name, "exchanges": str(self.exchanges), "restate": self.restate}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> LanguageBrain:
        """Raises ArgumentError when nothing was recorded for the task under these constraints."""
        path = exchanges_path(self.exchanges, task, constraint_set, seed)
        if not path.parent.is_dir():
            raise ArgumentError(
                f"brain.exchanges: there is no folder {path.parent}; a run with brain=openai makes it"
            )
        return LanguageBrain(self.name, ReplayChat(path), sight=None, restates=self.restate)

    def again(self) -> "ReplaySpec":
        return self
