"""The JSON in which RoboBrain answers, and how it becomes a Proposal (paper, supplementary A).

Every answer passes through here, also the scripted one, so that a plan written by a person and
one written by a language model are the same thing to the rest of the project.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator

from rf_exp.errors import StageError
from rf_exp.tasks import Task
from rf_exp.types import Constraint, Kind, Proposal, Scene, Subgoal, Violation

VERBS = ("grasp", "lift", "carry", "place", "strike", "press", "release", "home", "aside", "hold")
SUBGOAL_FORMS = (
    "grasp OBJECT at POINT",
    "lift OBJECT by H m",
    "carry OBJECT to TARGET [at POINT] [by H m]",
    "place OBJECT to TARGET [at POINT]",
    "strike OBJECT at POINT to TARGET [at POINT]",
    "press OBJECT at POINT",
    "release OBJECT",
    "home",
    "aside",
    "hold",
)


@dataclass(frozen=True)
class Question:
    """What RoboBrain is asked (paper, section 3.1): task, observations, history, feedback."""

    task: Task
    scene: Scene
    pictures: Mapping[str, NDArray[np.uint8]]  # camera -> (H, W, 3); empty without rendering
    previous: tuple[Subgoal, ...] = ()  # subgoals that were completed
    feedback: tuple[Violation, ...] = ()  # what RoboChecker found wrong with the last proposal


class Brain(Protocol):
    """Proposes the next subgoals and the constraints that must hold."""

    name: str

    def answer(self, question: Question) -> str:
        """The paper's JSON as text. Raises BadAnswer where there is none to be had."""
        ...


class BadAnswer(StageError):
    """No answer, or one that is not the paper's JSON or speaks of something that does not exist."""


class _Constraint(BaseModel):
    model_config = ConfigDict(extra="forbid")
    agents: list[str] = Field(default_factory=list, alias="Agents")
    text: str = Field(alias="Constraint", max_length=500)

    @model_validator(mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        if isinstance(value, dict) and "Agent" in value and "Agents" not in value:
            value = {**{k: v for k, v in value.items() if k != "Agent"}, "Agents": [value["Agent"]]}
        return value


class _Constraints(BaseModel):
    model_config = ConfigDict(extra="forbid")
    logical: list[_Constraint] = Field(default_factory=list, alias="Logical", max_length=100)
    temporal: list[_Constraint] = Field(default_factory=list, alias="Temporal", max_length=100)
    spatial: list[_Constraint] = Field(default_factory=list, alias="Spatial", max_length=100)


class _Answer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    subgoals: dict[str, str] = Field(alias="Subgoals", max_length=16)
    constraints: _Constraints = Field(default_factory=_Constraints, alias="Constraints")


def answer_schema(task: Task) -> dict[str, object]:
    """The JSON schema of an answer for servers that can hold a model to one.

    Narrower than what `from_json` takes: it lists the agents of the task, and every key is required,
    as strict structured output wants it.
    """
    names = [_name(agent) for agent in task.agents]
    strict = ConfigDict(extra="forbid")
    agent: Any = StrEnum("Agent", {name: name for name in names})
    subgoals: dict[str, Any] = {name: (str, ...) for name in names}
    fields: dict[str, Any] = {"Agents": (list[agent], ...), "Constraint": (str, ...)}
    entry: Any = create_model("Entry", __config__=strict, **fields)
    kinds: dict[str, Any] = {kind: (list[entry], ...) for kind in ("Logical", "Temporal", "Spatial")}
    answer = create_model(
        "Answer",
        __config__=strict,
        Subgoals=(create_model("Subgoals", __config__=strict, **subgoals), ...),
        Constraints=(create_model("Constraints", __config__=strict, **kinds), ...),
    )
    return answer.model_json_schema()


def to_json(proposal: Proposal) -> str:
    """The paper's JSON for a proposal; an agent's subgoals are joined by semicolons."""
    subgoals: dict[str, str] = {}
    for subgoal in proposal.subgoals:
        key = _name(subgoal.agent)
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


def _entry(constraint: Constraint) -> dict[str, object]:
    names = [_name(agent) for agent in constraint.agents]
    who: dict[str, object] = {"Agent": names[0]} if len(names) == 1 else {"Agents": names}
    return {**who, "Constraint": constraint.text}


def from_json(text: str, task: Task) -> Proposal:
    """The proposal in an answer. Agents keep the order in which the answer lists them.

    Raises BadAnswer that says what is wrong and what exists, fit to be sent back as feedback.
    """
    try:
        answer = _Answer.model_validate_json(text)
    except ValidationError as error:
        details = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'answer'}: {e['msg']}" for e in error.errors()[:5]
        )
        raise BadAnswer(f"the answer is not the expected JSON: {details}") from error
    subgoals = tuple(
        parse_subgoal(agent_number(name, task), part, task)
        for name, line in answer.subgoals.items()
        for part in line.split(";")
        if part.strip()
    )
    groups: Sequence[tuple[Kind, list[_Constraint]]] = (
        ("logical", answer.constraints.logical),
        ("temporal", answer.constraints.temporal),
        ("spatial", answer.constraints.spatial),
    )
    constraints = tuple(
        Constraint(kind, tuple(agent_number(name, task) for name in entry.agents), entry.text)
        for kind, entries in groups
        for entry in entries
    )
    return Proposal(subgoals, constraints)


def _name(agent: int) -> str:
    return f"Agent_{agent}"


def agent_number(name: str, task: Task) -> int:
    """`Agent_2` -> 2. Raises BadAnswer for an agent that is not in the task."""
    match = re.fullmatch(r"agent[_ ]?(\d{1,2})", name.strip(), re.IGNORECASE)
    if match is None or int(match[1]) not in task.agents:
        known = ", ".join(map(_name, task.agents))
        raise BadAnswer(f"unknown agent {name!r}; available: {known}")
    return int(match[1])


_SUBGOAL = re.compile(
    r"(?P<verb>\w+)"
    r"(?: (?P<object>(?!at\b|to\b|by\b)\w+))?"
    r"(?: at (?P<point>\w+))?"
    r"(?: to (?P<target>\w+)(?: at (?P<target_point>\w+))?)?"
    r"(?: by (?P<height>\d{1,2}(?:\.\d{1,4})?) ?m)?\.?",
    re.IGNORECASE,
)

# What each verb needs besides its agent.
_NEEDS = {
    "grasp": ("object", "point"),
    "press": ("object", "point"),
    "lift": ("object", "height_m"),
    "carry": ("object", "target"),
    "place": ("object", "target"),
    "strike": ("object", "point", "target"),
    "release": ("object",),
    "home": (),
    "aside": (),
    "hold": (),
}


def parse_subgoal(agent: int, text: str, task: Task) -> Subgoal:
    """`grasp barrier at left` -> Subgoal. Raises BadAnswer with the forms or names that exist."""
    match = _SUBGOAL.fullmatch(" ".join(text.split())[:200])
    if match is None or match["verb"].lower() not in VERBS:
        raise BadAnswer(
            f"cannot read subgoal {text.strip()[:80]!r} of Agent_{agent}; forms: {', '.join(SUBGOAL_FORMS)}"
        )
    height = float(match["height"]) if match["height"] else None
    subgoal = Subgoal(
        agent,
        match["verb"].lower(),
        match["object"],
        match["point"],
        match["target"],
        match["target_point"],
        height,
    )
    missing = [name for name in _NEEDS[subgoal.verb] if getattr(subgoal, name) is None]
    if missing:
        raise BadAnswer(f"subgoal {text.strip()!r} of Agent_{agent} lacks {' and '.join(missing)}")
    _check_names(subgoal, task)
    return subgoal


def _check_names(subgoal: Subgoal, task: Task) -> None:
    if subgoal.object is not None and subgoal.object not in task.objects:
        raise BadAnswer(
            f"no object {subgoal.object!r} in {task.name}; available: {', '.join(sorted(task.objects))}"
        )
    for name, point in ((subgoal.object, subgoal.point), (subgoal.target, subgoal.target_point)):
        if (
            name is not None
            and name in task.objects
            and point is not None
            and point not in task.asset(name).points
        ):
            listed = ", ".join(sorted(task.asset(name).points)) or "none"
            raise BadAnswer(f"{name} has no interaction point {point!r}; available: {listed}")
