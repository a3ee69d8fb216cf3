"""The JSON in which RoboBrain answers, and how it becomes a Proposal (paper, supplementary A).

Every answer passes through here, also the scripted one, so that a plan written by a person and
one written by a language model are the same thing to the rest of the project.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)

from rf_exp.datagen.brain.reading import BadAnswer, plain, read_object
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.statements import Proposal, Statement, agent_name, read_subgoal, understood
from rf_exp.tasks import Task
from rf_exp.texts import printable
from rf_exp.types import Kind, Scene, Subgoal

_COMMENTS = (  # keys under which a model says why it answers so
    "reason reasons reasoning rationale explanation explanations thought thoughts thinking analysis comment "
    "comments note notes id index"
)
_PARTS = ("subgoals", "constraints", "logical", "temporal", "spatial")


@dataclass(frozen=True)
class Question:
    """What RoboBrain is asked (paper, section 3.1): task, observations, history, feedback."""

    task: Task
    scene: Scene
    images: Mapping[str, NDArray[np.uint8]]  # camera -> (H, W, 3); empty without rendering
    previous: tuple[Subgoal, ...] = ()  # subgoals that were completed
    feedback: tuple[Violation, ...] = ()  # what RoboChecker found wrong with the last proposal


class Brain(Protocol):
    """Proposes the next subgoals and the constraints that must hold."""

    name: str

    def answer(self, question: Question) -> str:
        """The paper's JSON as text. Raises BadAnswer where there is none to be had."""
        ...


class _Part(BaseModel):
    """A part of an answer: its keys in any case. Others are left out where they say why, and no more."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _its_keys(cls, value: object) -> object:
        if not isinstance(value, dict):
            return value
        names = {plain(str(field.alias)): str(field.alias) for field in cls.model_fields.values()}
        found: dict[str, object] = {}
        for key, part in value.items():
            name = names.get(plain(str(key)))
            if name in found:
                raise ValueError(f"{name} is there twice")
            if name is not None:
                found[name] = part
            elif not cls._says_nothing(str(key), part):
                raise ValueError(
                    f"the key {printable(repr(key), 40)} is not understood; "
                    f"known: {', '.join(names.values())}"
                )
        return found

    @classmethod
    def _says_nothing(cls, key: str, part: object) -> bool:
        return plain(key) in _COMMENTS.split()


class _Constraint(_Part):
    agents: list[str] = Field(default_factory=list, alias="Agents", max_length=16, fail_fast=True)
    text: str = Field(alias="Constraint", max_length=500)

    @model_validator(mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        if not isinstance(value, dict):
            return value
        keys = ("Agents" if plain(str(key)) == "agent" else key for key in value)
        entry = list(zip(keys, value.values(), strict=True))
        if len({key for key, _ in entry}) < len(entry):
            raise ValueError("Agents is there twice")
        return {key: [part] if key == "Agents" and isinstance(part, str) else part for key, part in entry}


class _Constraints(_Part):
    logical: list[_Constraint] = Field(default_factory=list, alias="Logical", max_length=100)
    temporal: list[_Constraint] = Field(default_factory=list, alias="Temporal", max_length=100)
    spatial: list[_Constraint] = Field(default_factory=list, alias="Spatial", max_length=100)


class _Answer(_Part):
    subgoals: dict[str, str] = Field(alias="Subgoals", max_length=16)
    constraints: _Constraints = Field(default_factory=_Constraints, alias="Constraints")

    @classmethod
    def _says_nothing(cls, key: str, part: object) -> bool:
        """Round the answer a model may tell what it likes, but nothing that looks like a part of it."""
        told = not isinstance(part, dict | list) and not get_close_matches(plain(key), _PARTS, cutoff=0.7)
        return told or plain(key) in _COMMENTS.split()

    @field_validator("subgoals", mode="before")
    @classmethod
    def _lines(cls, value: object) -> object:
        """Several subgoals of an agent as a list; none as null."""
        if not isinstance(value, dict):
            return value
        return {
            key: "; ".join(part)
            if isinstance(part, list) and all(isinstance(p, str) for p in part)
            else part or ""
            for key, part in value.items()
        }


def strict_answer(task: Task) -> type[BaseModel]:
    """An answer whose JSON schema is for servers that can hold a model to one.

    Narrower than what `from_json` takes: it lists the agents of the task, and every key is required,
    as strict structured output wants it.
    """
    names = [agent_name(agent) for agent in task.agents]
    strict = ConfigDict(extra="forbid")
    agent: Any = StrEnum("Agent", {name: name for name in names})
    subgoals: dict[str, Any] = {name: (str, ...) for name in names}
    fields: dict[str, Any] = {"Agents": (list[agent], ...), "Constraint": (str, ...)}
    entry: Any = create_model("Entry", __config__=strict, **fields)
    kinds: dict[str, Any] = {kind: (list[entry], ...) for kind in ("Logical", "Temporal", "Spatial")}
    return create_model(
        "Answer",
        __config__=strict,
        Subgoals=(create_model("Subgoals", __config__=strict, **subgoals), ...),
        Constraints=(create_model("Constraints", __config__=strict, **kinds), ...),
    )


def to_json(proposal: Proposal) -> str:
    """The paper's JSON for a proposal; an agent's subgoals are joined by semicolons."""
    subgoals: dict[str, str] = {}
    for subgoal in proposal.subgoals:
        key = agent_name(subgoal.agent)
        subgoals[key] = f"{subgoals[key]}; {subgoal.text}" if key in subgoals else subgoal.text
    kinds: tuple[Kind, ...] = ("logical", "temporal", "spatial")
    return json.dumps(
        {
            "Subgoals": subgoals,
            "Constraints": {
                kind.capitalize(): [_entry(c) for c in proposal.constraints if c.kind == kind]
                for kind in kinds
            },
        },
        indent=2,
    )


def _entry(stated: Statement) -> dict[str, object]:
    names = [agent_name(agent) for agent in stated.agents]
    who: dict[str, object] = {"Agent": names[0]} if len(names) == 1 else {"Agents": names}
    return {**who, "Constraint": stated.sentence}


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
        raise BadAnswer(f"the answer is not the expected JSON: {details}") from error
    lines: dict[int, str] = {}
    for name, line in answer.subgoals.items():
        if lines.setdefault(agent_number(name, task), line) is not line:
            raise BadAnswer(f"the subgoals of Agent_{agent_number(name, task)} are there twice")
    subgoals = tuple(subgoal for agent, line in lines.items() for subgoal in _subgoals(agent, line, task))
    groups: Sequence[tuple[Kind, list[_Constraint]]] = (
        ("logical", answer.constraints.logical),
        ("temporal", answer.constraints.temporal),
        ("spatial", answer.constraints.spatial),
    )
    constraints = tuple(
        understood(
            entry.text, task.vocabulary, kind, tuple(agent_number(name, task) for name in entry.agents)
        )
        for kind, entries in groups
        for entry in entries
    )
    return Proposal(subgoals, constraints)


def agent_number(name: str, task: Task) -> int:
    """`Agent_2` -> 2. Raises BadAnswer for an agent that is not in the task."""
    match = re.fullmatch(r"agent[_ ]?(\d{1,2})", name.strip(), re.IGNORECASE)
    if match is None or int(match[1]) not in task.agents:
        known = ", ".join(map(agent_name, task.agents))
        raise BadAnswer(f"unknown agent {printable(repr(name), 80)}; available: {known}")
    return int(match[1])


def most_subgoals(task: Task) -> int:
    """Of one agent in one answer: to take each object, move it twice and let it go, and to yield."""
    return 4 * len(task.objects) + 2


def _subgoals(agent: int, line: str, task: Task) -> list[Subgoal]:
    """The subgoals in an agent's line. Raises BadAnswer for more than the task can have use for."""
    parts = [part for part in line.split(";") if part.strip()]
    if len(parts) > most_subgoals(task):
        raise BadAnswer(
            f"Agent_{agent} has {len(parts)} subgoals; in one answer for {task.name} an agent has up to "
            f"{most_subgoals(task)}"
        )
    found = [_read_subgoal(agent, part, task) for part in parts]
    for each, following in pairwise(found):
        if each == following:
            raise BadAnswer(f"Agent_{agent} has the subgoal {each.text!r} twice in a row")
    return found


def _read_subgoal(agent: int, text: str, task: Task) -> Subgoal:
    try:
        return read_subgoal(agent, text, task.vocabulary)
    except ArgumentError as error:
        raise BadAnswer(str(error)) from error
