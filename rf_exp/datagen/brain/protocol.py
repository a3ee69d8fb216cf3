"""RoboBrain's questions, and the parser from its JSON answers to a Proposal (paper, supplementary A).

Every answer passes through here, also the scripted one, so that the rest of the project treats hand-written
and generated plans alike. A model may write its JSON bare, in prose, in fences, round or after its thinking,
or in a tool call: exactly one object is read. Where there is none, or several, the error says what was found
instead, fit to be sent back as feedback.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)

from rf_exp.datagen.brain.legal import LegalAnswers
from rf_exp.errors import StageError
from rf_exp.findings import Finding, ParseError, Violation
from rf_exp.statements import Proposal, agent_name, read_or_unparsed, read_subgoal
from rf_exp.tasks import Task
from rf_exp.texts import printable
from rf_exp.types import ANY_AGENT, ConstraintSet, Kind, Scene, Subgoal

KINDS: tuple[Kind, ...] = get_args(Kind)
_COMMENTS = (  # keys under which a model may explain its answer
    "reason reasons reasoning rationale explanation explanations thought thoughts thinking analysis comment "
    "comments note notes id index"
)

MAX_CONSTRAINTS_PER_KIND = 4  # constraints for each agent, where a schema lists the legal ones
MAX_CHARACTERS = 200_000  # an answer has a few thousand
_MAX_WRAPPERS = 4  # nested wrappers round an answer
_MAX_FAILURES = 16  # braces without valid JSON after which the search ends
_QUOTED_CHARACTERS = 60  # of a text in errors
_THINKING = r"(?:think|thinking|thought|thoughts|reasoning|analysis|reflection)"
_OPENING_TAG = re.compile(rf"<{_THINKING}>", re.IGNORECASE)
_CLOSING_TAG = re.compile(rf"</{_THINKING}>", re.IGNORECASE)
_OBJECT_START = re.compile(r'\{\s*(?:["}]|$)')
_REFUSAL = re.compile(
    r"\W*(?:i(?:['\u2019]m| am) sorry|sorry|as an ai|"
    r"i (?:can(?:not|['\u2019]t)|am unable|won['\u2019]t|refuse))\b",
    re.IGNORECASE,
)


class BadAnswer(StageError):
    """Raised for a missing answer, and for one that is not the paper's JSON or names what does not exist."""

    def __init__(self, message: object, finding: Finding = Finding.REFUSED) -> None:
        super().__init__(message)
        self.finding = finding


@dataclass(frozen=True)
class Question:
    """Question to RoboBrain (paper, section 3.1): task, observations, history, feedback."""

    task: Task
    scene: Scene
    images: Mapping[str, NDArray[np.uint8]]  # camera -> (H, W, 3); empty without rendering
    previous: tuple[Subgoal, ...] = ()  # subgoals that were completed
    feedback: tuple[Violation, ...] = ()  # RoboChecker's objections to the last proposal


class Brain(Protocol):
    """Source of proposals: the next subgoals and the constraints that must hold."""

    name: str

    def answer(self, question: Question) -> str:
        """The paper's JSON as text. Raises BadAnswer where none is obtained."""
        ...


@runtime_checkable
class BrainSpec(Protocol):
    """Specification of a brain, as in `conf/brain/<name>.yaml`. Implementations are frozen dataclasses.

    It is sent to worker processes, which make a new brain for every episode.
    """

    name: ClassVar[str]
    reads: ClassVar[bool] = False  # whether title, description and pictures of the task affect its answers

    @property
    def label(self) -> str:
        """Its name in rows and in file names: `scripted`, `openai+gpt-4o`."""
        return self.name

    @property
    def folder(self) -> Path | None:
        """Folder of the recorded exchanges with a model; None: they are not recorded."""
        return None

    @property
    def identity(self) -> Mapping[str, object]:
        """JSON values that determine the answers: runs that differ here must not be mixed."""
        return {"name": self.name}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> Brain:
        """The brain for one episode. Raises ArgumentError for what this machine lacks."""
        ...

    def again(self) -> "BrainSpec":
        """The specification that reproduces an episode which has been generated."""
        return self


def normalised_key(key: str) -> str:
    """A key, normalised: `Sub-goals` and `subgoals` are equal."""
    return re.sub(r"[\W_]", "", key.casefold())


def read_object(text: str, key: str) -> dict[str, Any]:
    """The one JSON object with `key` in a text. Raises BadAnswer that says what was found instead."""
    if len(text) > MAX_CHARACTERS:
        message = f"the answer has {len(text)} characters; an answer has up to {MAX_CHARACTERS}"
        raise BadAnswer(message, Finding.OTHER_FORM)
    thinking, reply = _split_thinking(text)
    answers: list[dict[str, Any]] = []
    reason = "it is empty"
    for part in (reply, thinking):
        objects, error = _objects(part)
        answers = [answer for value in objects for answer in _objects_with_key(value, normalised_key(key))]
        if answers or error:
            reason = error
        elif objects:
            keys = ", ".join(printable(repr(name), 40) for name in list(objects[-1])[:5]) or "nothing"
            reason = f"its JSON lacks {key!r}; it holds {keys}"
        elif part.strip():
            reason = _no_json_reason(part) if part is reply else "it is thinking only, which no JSON follows"
        else:
            continue
        break
    if any(answer != answers[0] for answer in answers):
        message = f"the answer holds {len(answers)} different objects with {key!r}; send one"
        raise BadAnswer(message, Finding.OTHER_FORM)
    if not answers:
        raise BadAnswer(f"the answer is not the expected JSON: {reason}", Finding.NO_JSON)
    if reason:  # an answer beside a broken object is ambiguous
        message = f"the answer is not the expected JSON: beside a whole object, {reason}"
        raise BadAnswer(message, Finding.OTHER_FORM)
    return answers[0]


def _split_thinking(text: str) -> tuple[str, str]:
    """(thinking, answer). Chat templates may leave out the first tag, or cut off before the last."""
    ends = [match.end() for match in _CLOSING_TAG.finditer(text)]
    if ends:
        return text[: ends[-1]], text[ends[-1] :]
    opening = _OPENING_TAG.search(text)
    return (text[opening.start() :], text[: opening.start()]) if opening else ("", text)


def _objects(text: str) -> tuple[list[dict[str, Any]], str]:
    """The outermost JSON objects in a text, and the error of one that is broken; empty for none."""
    objects: list[dict[str, Any]] = []
    first_error, position, failures = "", 0, 0
    while failures < _MAX_FAILURES and (match := _OBJECT_START.search(text, position)):
        try:
            value, position = _DECODER.raw_decode(text, match.start())
            objects.append(value)
        except json.JSONDecodeError as error:
            # An object within a broken one is a part of it, and no answer.
            cut_off = error.msg.startswith("Unterminated string") or not text[error.pos :].strip(" \t\r\n`")
            failures += 1
            first_error = first_error or ("it is cut off" if cut_off else f"{error.msg}, line {error.lineno}")
            position = len(text) if cut_off else max(error.pos, match.end())
        except RecursionError:
            return objects, "it is nested too deeply"
        except ValueError as error:
            return objects, str(error)
    return objects, first_error


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of key-value pairs. Raises ValueError for a duplicate key: all but its last were lost."""
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        duplicate = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {printable(repr(duplicate), 40)} is there twice")
    return result


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")


_DECODER = json.JSONDecoder(object_pairs_hook=_unique_keys, parse_constant=_refuse_constant, strict=False)


def _objects_with_key(value: object, key: str, depth: int = 0) -> Iterator[dict[str, Any]]:
    """The objects with the key: this one, or those that it wraps, as a tool call does."""
    if isinstance(value, dict) and any(normalised_key(name) == key for name in value):
        yield value
    elif depth < _MAX_WRAPPERS:
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        for item in inner:
            if isinstance(item, str) and isinstance(value, dict) and value.get("arguments") is item:
                for nested in _objects(item)[0]:
                    yield from _objects_with_key(nested, key, depth + 1)
            else:
                yield from _objects_with_key(item, key, depth + 1)


def _no_json_reason(text: str) -> str:
    if _REFUSAL.match(text):
        raise BadAnswer(f"the model refuses: {printable(text)}", Finding.DECLINED)
    return f"there is no JSON in it, only text that begins {printable(text, _QUOTED_CHARACTERS)!r}"


class _Part(BaseModel):
    """Part of an answer, with keys in any case. Other keys are ignored if they explain, refused otherwise."""

    model_config = ConfigDict(extra="forbid")
    aliases: ClassVar[dict[str, str]] = {}  # alternative key -> key

    @model_validator(mode="before")
    @classmethod
    def _normalise_keys(cls, value: object) -> object:
        if not isinstance(value, dict):
            return value
        known = [str(field.alias) for field in cls.model_fields.values()]
        names = {**{normalised_key(alias): alias for alias in known}, **cls.aliases}
        result: dict[str, object] = {}
        for key, part in value.items():
            name = names.get(normalised_key(str(key)))
            if name in result:
                raise ValueError(f"{name} is there twice")
            if name is not None:
                result[name] = part
            elif not cls._is_ignorable(str(key), part):
                message = f"the key {printable(repr(key), 40)} is not understood"
                raise ValueError(f"{message}; known: {', '.join(known)}")
        return result

    @classmethod
    def _is_ignorable(cls, key: str, part: object) -> bool:
        return normalised_key(key) in _COMMENTS.split()


class _Constraint(_Part):
    aliases: ClassVar[dict[str, str]] = {"agent": "Agents"}

    agents: list[str] = Field(default_factory=list, alias="Agents", max_length=16, fail_fast=True)
    text: str = Field(alias="Constraint", max_length=500)

    @field_validator("agents", mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        return [value] if isinstance(value, str) else value


class _Constraints(_Part):
    logical: list[_Constraint] = Field(default_factory=list, alias="Logical", max_length=100)
    temporal: list[_Constraint] = Field(default_factory=list, alias="Temporal", max_length=100)
    spatial: list[_Constraint] = Field(default_factory=list, alias="Spatial", max_length=100)


def _joined(part: Any) -> object:
    """The line of an agent's subgoals, which a model may also give as a list, or as null for none."""
    several = isinstance(part, list) and all(isinstance(each, str) for each in part)
    return "; ".join(part) if several else part or ""


class _Answer(_Part):
    subgoals: dict[str, Annotated[str, BeforeValidator(_joined)]] = Field(alias="Subgoals", max_length=16)
    constraints: _Constraints = Field(default_factory=_Constraints, alias="Constraints")

    @classmethod
    def _is_ignorable(cls, key: str, part: object) -> bool:
        """Any text or number beside the answer is ignored too, unless its key resembles a part of it."""
        parts = ("subgoals", "constraints", *KINDS)
        key = normalised_key(key)
        is_remark = not isinstance(part, dict | list) and not get_close_matches(key, parts, cutoff=0.7)
        return is_remark or key in _COMMENTS.split()


def strict_answer(task: Task, legal: LegalAnswers | None = None) -> type[BaseModel]:
    """Model of an answer whose JSON schema is for servers with structured output.

    It lists the agents of the task and, if there are several, anybody. With the `legal` answers in a scene it
    lists, without anybody, every subgoal of every agent and every constraint, and no other can be written.
    Every key is required, as strict structured output demands.
    """
    several = len(task.agents) > 1 and legal is None  # otherwise no job is left open
    names = [agent_name(agent) for agent in (*task.agents, *((ANY_AGENT,) if several else ()))]
    strict = ConfigDict(extra="forbid")
    agent: Any = StrEnum("Agent", {name: name for name in names})
    subgoals: dict[str, Any] = {name: (str, ...) for name in names}
    if legal is not None:
        count = max_subgoals(task)
        lines = {agent_name(agent): [each.text for each in some] for agent, some in legal.subgoals.items()}
        subgoals = {name: (_bounded_list(Literal[tuple(texts)], count), ...) for name, texts in lines.items()}

    def entries(kind: Kind) -> Any:
        sentence: Any = str
        if legal is not None:
            sentences = [each.sentence for each in legal.constraints if each.kind == kind]
            sentence = Literal[tuple(sentences) or ("",)]
        fields: dict[str, Any] = {"Agents": (list[agent], ...), "Constraint": (sentence, ...)}
        entry: Any = create_model(f"{kind.capitalize()}Entry", __config__=strict, **fields)
        count = MAX_CONSTRAINTS_PER_KIND * len(task.agents)
        return list[entry] if legal is None else _bounded_list(entry, count)

    kinds: dict[str, Any] = {kind.capitalize(): (entries(kind), ...) for kind in KINDS}
    return create_model(
        "Answer",
        __config__=strict,
        Subgoals=(create_model("Subgoals", __config__=strict, **subgoals), ...),
        Constraints=(create_model("Constraints", __config__=strict, **kinds), ...),
    )


def _bounded_list(item: Any, max_length: int) -> Any:
    """A list of up to `max_length` items."""
    return Annotated[list[item], Field(max_length=max_length)]


def to_json(proposal: Proposal) -> str:
    """The paper's JSON for a proposal; an agent's subgoals are joined by semicolons."""
    subgoals: dict[str, str] = {}
    for subgoal in proposal.subgoals:
        key = agent_name(subgoal.agent)
        subgoals[key] = f"{subgoals[key]}; {subgoal.text}" if key in subgoals else subgoal.text
    constraints: dict[str, list[object]] = {kind.capitalize(): [] for kind in KINDS}
    for constraint in proposal.constraints:
        names = [agent_name(agent) for agent in constraint.agents]
        listed_agents = {"Agent": names[0]} if len(names) == 1 else {"Agents": names}
        constraints[constraint.kind.capitalize()].append({**listed_agents, "Constraint": constraint.sentence})
    return json.dumps({"Subgoals": subgoals, "Constraints": constraints}, indent=2)


def from_json(text: str, task: Task) -> Proposal:
    """The proposal in an answer. Agents keep the order in which the answer lists them.

    Raises BadAnswer that says what is wrong and what exists, fit to be sent back as feedback.
    """
    try:
        answer = _Answer.model_validate(read_object(text, "Subgoals"))
    except ValidationError as error:
        details = "; ".join(
            f"{printable('.'.join(map(str, e['loc'])), 60) or 'answer'}: {e['msg']}"
            for e in error.errors()[:5]
        )
        message = f"the answer is not the expected JSON: {details}"
        raise BadAnswer(message, Finding.OTHER_FORM) from error
    lines: dict[int, str] = {}
    for name, line in answer.subgoals.items():
        if lines.setdefault(agent_number(name, task), line) is not line:
            message = f"the subgoals of Agent_{agent_number(name, task)} are there twice"
            raise BadAnswer(message, Finding.OTHER_FORM)
    subgoals = tuple(subgoal for agent, line in lines.items() for subgoal in _subgoals(agent, line, task))
    constraints = []
    for kind in KINDS:
        for entry in getattr(answer.constraints, kind):
            agents = tuple(agent_number(name, task) for name in entry.agents)
            constraints.append(read_or_unparsed(entry.text, task.vocabulary, kind, agents))
    return Proposal(subgoals, tuple(constraints))


def agent_number(name: str, task: Task) -> int:
    """`Agent_2` -> 2, `Anybody` -> 0. Raises BadAnswer for an agent that is not in the task."""
    if normalised_key(name) == normalised_key(agent_name(ANY_AGENT)):
        return ANY_AGENT
    match = re.fullmatch(r"agent[_ ]?(\d{1,2})", name.strip(), re.IGNORECASE)
    if match is None or int(match[1]) not in task.agents:
        known = ", ".join(map(agent_name, task.agents))
        message = f"unknown agent {printable(repr(name), 80)}; available: {known}"
        raise BadAnswer(message, Finding.UNKNOWN_AGENT)
    return int(match[1])


def max_subgoals(task: Task) -> int:
    """Bound on an agent's subgoals in one answer: grasp each object, move it twice, release it, and yield."""
    return 4 * len(task.objects) + 2


def _subgoals(agent: int, line: str, task: Task) -> list[Subgoal]:
    """The subgoals in an agent's line. Raises BadAnswer for too many, unreadable or repeated ones."""
    parts = [part for part in line.split(";") if part.strip()]
    if len(parts) > (max_count := max_subgoals(task)):
        limit = f"in one answer for {task.name} an agent has up to {max_count}"
        message = f"Agent_{agent} has {len(parts)} subgoals; {limit}"
        raise BadAnswer(message, Finding.TOO_MANY_SUBGOALS)
    try:
        subgoals = [read_subgoal(agent, part, task.vocabulary) for part in parts]
    except ParseError as error:
        raise BadAnswer(str(error), error.finding) from error
    for subgoal, following in pairwise(subgoals):
        if subgoal == following:
            message = f"Agent_{agent} has the subgoal {subgoal.text!r} twice in a row"
            raise BadAnswer(message, Finding.UNREAD_SUBGOAL)
    return subgoals
