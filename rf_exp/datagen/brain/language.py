"""RoboBrain by a language model, live or from a recording: specifications and prompts."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import ClassVar, cast, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from rf_exp.artifacts import drop_defaults
from rf_exp.datagen.brain.chat import Chat, Connection, Message, OpenAIChat, ReplayChat, exchanges_path
from rf_exp.datagen.brain.legal import legal_answers
from rf_exp.datagen.brain.protocol import (
    BadAnswer,
    BrainSpec,
    Question,
    from_json,
    read_object,
    strict_answer,
    to_json,
)
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.findings import Dialogue
from rf_exp.statements import Proposal, UnparsedStatement, read_or_unparsed, samples, subgoal_forms
from rf_exp.tasks import Task
from rf_exp.texts import shown
from rf_exp.transforms import Matrix
from rf_exp.types import LARGEST_PX, SMALLEST_PX, CameraChoice, ConstraintSet, Pictures, camera_names

JPEG_QUALITY = 90
MAX_NAME_LENGTH = 60  # characters of a model's name in file names
MAX_QUOTED_ANSWER = 6000  # characters of its last answer that a prompt repeats


class LanguageBrain:
    """Language model as a brain: describes the scene in text, and has unclear constraints restated."""

    def __init__(self, spec: "OpenAISpec | ReplaySpec", chat: Chat) -> None:
        self.name, self._spec, self._chat = spec.name, spec, chat
        self._last_answer = ""  # the last answer, verbatim

    def with_usage(self, dialogue: Dialogue) -> Dialogue:
        """The dialogue of a finished episode, with the numbers of calls and tokens.

        The outcome of each proposal is recorded beside its exchange.
        """
        verdicts = [" ".join(filter(None, (each.ruling, each.code))) for each in dialogue.answers]
        self._chat.record_verdicts(verdicts)
        exchanges, tokens = self._chat.exchanges, Counter[str]()
        for each in exchanges:
            tokens.update(asdict(each.usage) if each.usage is not None else {})
        return replace(dialogue, calls=len(exchanges), **tokens)

    def answer(self, question: Question) -> str:
        live = self._spec if isinstance(self._spec, OpenAISpec) else None
        legal = legal_answers(question.task, question.scene) if live is not None and live.enumerated else None
        schema = strict_answer(question.task, legal).model_json_schema()
        pictures = live.jpegs(question.images, len(question.task.agents)) if live is not None else {}
        messages = _messages(question, pictures, self._last_answer if question.feedback else "")
        self._last_answer = ""  # in case the model gives none now
        self._last_answer = text = self._chat.ask("propose", messages, schema)
        if not self._spec.restate:
            return text
        try:
            proposal = from_json(text, question.task)
        except BadAnswer:
            return text  # the generation loop reports the error
        return to_json(_restate_unclear(proposal, question.task, self._chat))


@dataclass(frozen=True)
class OpenAISpec(Connection, BrainSpec):
    """`brain=openai`: any server with the chat completions API."""

    name: ClassVar[str] = "openai"
    reads: ClassVar[bool] = True

    pictures: bool  # whether to send them
    cameras: str  # whose pictures to send: all | local | global
    picture_px: int | None  # longer side to which pictures are scaled; None: as rendered
    restate: bool  # whether constraints outside the grammar are restated
    exchanges: Path | None  # parent of the recordings' folders, one per model; None: not recorded

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cameras not in get_args(CameraChoice):
            raise unknown_choice("brain.cameras", self.cameras, get_args(CameraChoice))
        if self.picture_px is not None and not SMALLEST_PX <= self.picture_px <= LARGEST_PX:
            raise ArgumentError(
                f"brain.picture_px is {self.picture_px}; possible are {SMALLEST_PX} to {LARGEST_PX} pixels, "
                "and null: as the cameras take them"
            )

    def check(self, rendered: Pictures) -> None:
        """Raises ArgumentError where pictures are to be sent that are not rendered."""
        if self.cameras == "all" or not self.pictures:
            return
        if not rendered.render:
            raise ArgumentError(
                f"brain.cameras={self.cameras}, but render=false takes no pictures; use render=true, "
                "brain.pictures=false or brain.cameras=all: of those there are"
            )
        if rendered.cameras not in ("all", self.cameras):
            raise ArgumentError(
                f"brain.cameras={self.cameras}, but cameras={rendered.cameras} takes other pictures; use "
                f"cameras=all, cameras={self.cameras} or brain.cameras=all: of those there are"
            )

    def jpegs(self, pictures: Mapping[str, NDArray[np.uint8]], agents: int) -> dict[str, bytes]:
        """Camera -> JPEG of the pictures to send, among (H, W, 3) RGB ones of a scene with so many agents."""
        chosen = camera_names(cast(CameraChoice, self.cameras), agents) if self.pictures else ()
        return {name: self._jpeg(picture) for name, picture in pictures.items() if name in chosen}

    def _jpeg(self, picture: NDArray[np.uint8]) -> bytes:
        import cv2  # slow import, only for live models

        bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        if self.picture_px is not None:
            height, width = picture.shape[:2]
            scale = self.picture_px / max(height, width)
            size = max(1, round(width * scale)), max(1, round(height * scale))
            bgr = cv2.resize(bgr, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()

    @property
    def label(self) -> str:
        """The name with that of the model, made fit for file names."""
        model = re.sub(r"[^\w.=-]", "-", self.model, flags=re.ASCII)[:MAX_NAME_LENGTH]
        return f"{self.name}+{model}"

    @property
    def folder(self) -> Path | None:
        return self.exchanges and self.exchanges / self.label

    @property
    def identity(self) -> dict[str, object]:
        """The options that determine the answers; time limits and budget do not."""
        keys = ("model", "base_url", "structured", "temperature", "max_tokens", "pictures", "restate")
        defaults = {"extra_body": None, "cameras": "all", "picture_px": None, "enumerated": False}
        options = {key: getattr(self, key) for key in (*keys, *defaults)}
        return {"name": self.name, **drop_defaults(options, **defaults)}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> LanguageBrain:
        path = exchanges_path(self.folder, task, constraint_set, seed) if self.folder else None
        return LanguageBrain(self, OpenAIChat(self, path))

    def again(self) -> BrainSpec:
        """The replay of the answers, if they are recorded."""
        return ReplaySpec(self.folder, self.restate) if self.folder else self


@dataclass(frozen=True)
class ReplaySpec(BrainSpec):
    """`brain=replay`: recorded exchanges."""

    name: ClassVar[str] = "replay"
    reads: ClassVar[bool] = True

    exchanges: Path  # folder of one model, as written by `brain=openai`
    restate: bool  # as in the recorded run

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name, "exchanges": str(self.exchanges), "restate": self.restate}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> LanguageBrain:
        """Raises ArgumentError when nothing was recorded for the task under these constraints."""
        path = exchanges_path(self.exchanges, task, constraint_set, seed)
        if not path.parent.is_dir():
            message = f"brain.exchanges: there is no folder {path.parent}"
            raise ArgumentError(f"{message}; a run with brain=openai makes it")
        return LanguageBrain(self, ReplayChat(path))


def constraint_forms() -> str:
    """Sample sentences of the grammar, some of every kind."""
    return bullet_list(sample.sentence for sample in samples())


def _messages(question: Question, pictures: Mapping[str, bytes], last_answer: str) -> tuple[Message, Message]:
    """The system prompt, and the description of the present scene, with JPEGs of it.

    The model's last answer is repeated beside the objections to it, so that it need not guess.
    """
    task, scene = question.task, question.scene
    system = fill_prompt("propose", subgoals=bullet_list(subgoal_forms()), constraints=constraint_forms())
    text = fill_prompt(
        "question",
        title=task.title,
        description=task.description,
        target=task.target_condition,
        agents=bullet_list(_agents(question)),
        objects=bullet_list(_objects(question)),
        places=bullet_list(f"{name}: {_position_text(pose)}" for name, pose in task.places(scene).items()),
        previous=bullet_list(f"Agent_{subgoal.agent}: {subgoal.text}" for subgoal in question.previous),
        proposal=shown(last_answer, MAX_QUOTED_ANSWER) if last_answer else "none",
        feedback=bullet_list(f"{violation.check}: {violation.sentence}" for violation in question.feedback),
    )
    return Message("system", system), Message("user", text, pictures)


def _agents(question: Question) -> Iterator[str]:
    task = question.task
    for agent, robot, held in zip(task.agents, task.robots, question.scene.held, strict=True):
        yield (
            f"Agent_{agent}: base at ({robot.x_m:.2f}, {robot.y_m:.2f}), facing {robot.yaw_deg:.0f} deg; "
            f"holds {held or 'nothing'}"
        )


def _objects(question: Question) -> Iterator[str]:
    task = question.task
    for name, pose in question.scene.poses.items():
        asset = task.asset(name)
        size_m = np.ptp(asset.bounds_m, axis=0)
        yaw_deg = np.round(np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))) + 0.0
        kind = "a mark on the table" if asset.visual_only else "fixed" if asset.static else "movable"
        yield (
            f"{name}: {_position_text(pose)}, turned {yaw_deg:.0f} deg, "
            f"{size_m[0]:.2f} x {size_m[1]:.2f} x {size_m[2]:.2f} m, {kind}"
        )
        for label, point in asset.points.items():
            world_from_tcp = pose @ point.object_from_tcp
            along = ", ".join(f"{value:.1f}" for value in np.round(world_from_tcp[:3, 2], 1) + 0.0)
            yield f"{name}, point {label}: to {point.kind}, {_position_text(world_from_tcp)}, along ({along})"


def _position_text(pose: Matrix) -> str:
    # Adding zero turns -0.0 into 0.0, so that noise around zero does not change the text.
    x, y, z = np.round(pose[:3, 3], 3) + 0.0
    return f"at ({x:.3f}, {y:.3f}, {z:.3f})"


class _Restated(BaseModel):
    model_config = ConfigDict(extra="forbid")
    Sentences: list[str]


def _restate_unclear(proposal: Proposal, task: Task, chat: Chat) -> Proposal:
    """The proposal with constraints that were not understood restated by a model, in one call for all.

    The paper lets a model match each constraint to a validator and its parameters. Here it may only restate
    the constraint in a sentence of the grammar, which does the matching. What a model writes is parsed, never
    executed. Where it has no better sentence the constraint stays as it is, and the checker reports it:
    restating cannot help a sentence about something that does not exist.
    """
    unclear = [statement for statement in proposal.constraints if isinstance(statement, UnparsedStatement)]
    if not unclear:
        return proposal
    text = fill_prompt(
        "unclear",
        objects=bullet_list(
            f"{name}: {', '.join(task.asset(name).points) or 'none'}" for name in task.objects
        ),
        subgoals=bullet_list(f"Agent_{subgoal.agent}: {subgoal.text}" for subgoal in proposal.subgoals),
        unclear="\n".join(f"{number}. {each.sentence}" for number, each in enumerate(unclear, start=1)),
    )
    system = Message("system", fill_prompt("restate", constraints=constraint_forms()))
    try:
        text = chat.ask("restate", (system, Message("user", text)), _Restated.model_json_schema())
        sentences = _Restated.model_validate(read_object(text, "Sentences")).Sentences
    except (BadAnswer, ValidationError):
        return proposal
    if len(sentences) != len(unclear):
        return proposal
    restated = {
        old: new
        for old, sentence in zip(unclear, sentences, strict=True)
        if not isinstance(
            new := read_or_unparsed(sentence, task.vocabulary, old.kind, old.agents), UnparsedStatement
        )
    }
    constraints = (
        restated.get(each, each) if isinstance(each, UnparsedStatement) else each
        for each in proposal.constraints
    )
    return replace(proposal, constraints=tuple(constraints))


def fill_prompt(name: str, **parts: str) -> str:
    """The text of `prompts/<name>.txt` with its `string.Template` placeholders filled in."""
    text = files("rf_exp.datagen.brain").joinpath("prompts", f"{name}.txt").read_text(encoding="utf-8")
    return Template(text).substitute(parts)


def bullet_list(lines: Iterable[str]) -> str:
    """A bulleted list of lines; `none` where there are none."""
    return "\n".join(f"- {line}" for line in lines) or "none"
