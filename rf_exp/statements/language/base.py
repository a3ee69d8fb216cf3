"""Base classes of statements, and their parts: names of a task, events of its plans, words of a sentence."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.findings import Finding, ParseError, agent_name
from rf_exp.statements.language.notation import (
    AGENT,
    ANY_AGENT_TOKEN,
    NUMBER,
    Quantity,
    Vector,
    object_name,
    quantity,
)
from rf_exp.statements.language.verbs import VERBS
from rf_exp.types import ANY_AGENT, Kind, Subgoal

TABLE = "table"  # surface of named places
ZONE_LIMIT_M = 10.0  # largest coordinate of a zone
MAX_WAIT_S = 600.0
TOGETHER_S = 0.1  # tolerance of `simultaneously` unless a time is given
_SYNONYMS = {"centre": "center", "middle": "center"}  # of names of points

Names = tuple[tuple[str, str | None], ...]  # (object, its interaction point where one is named)


def agent_list(agents: tuple[int, ...]) -> str:
    """`Agent_1 and Agent_2`, or `Agent_1, Agent_2 and Agent_3`."""
    *first, last = map(agent_name, agents)
    return f"{', '.join(first)} and {last}"


@dataclass(frozen=True)
class Vocabulary:
    """The names of one task."""

    agents: tuple[int, ...]
    points: Mapping[str, Mapping[str, str]]  # object -> its interaction points -> their kinds
    sides: Mapping[str, int] = field(default_factory=dict)  # e.g. "left" -> the agent there

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(self.points)

    def find_object(self, name: str) -> str | None:
        """The object of that name, ignoring case: sentences are read in lower case."""
        return _match_name(name, self.points)

    def agent(self, number: int, context: str) -> int:
        """The agent of that number. Raises ArgumentError that lists the known ones."""
        if number not in self.agents:
            unknown = unknown_choice(f"agent in {context}:", agent_name(number), map(agent_name, self.agents))
            raise ParseError(unknown, Finding.UNKNOWN_AGENT)
        return number

    def object(self, name: str, context: str) -> str:
        """The object of that name. Raises ArgumentError that lists the known ones."""
        name_in_task = self.find_object(name)
        if name_in_task is None:
            raise ParseError(
                unknown_choice(f"object in {context}:", name, self.points), Finding.UNKNOWN_OBJECT
            )
        return name_in_task

    def point(self, name: str, point: str, context: str) -> str:
        """The interaction point of an object. Raises ArgumentError that lists the known ones."""
        points = self.points[name]
        point_in_task = _match_name(point, points) or _match_name(_SYNONYMS.get(point, point), points)
        if point_in_task is None:
            unknown = unknown_choice(f"point of {name} in {context}:", point, points)
            raise ParseError(unknown, Finding.UNKNOWN_POINT)
        return point_in_task

    def __str__(self) -> str:
        """All names in one line, for error messages."""
        objects = (
            f"{name} ({', '.join(points)})" if points else name for name, points in self.points.items()
        )
        return (
            f"agents: {', '.join(map(agent_name, self.agents))}; "
            f"objects with their points: {', '.join(objects) or 'none'}"
        )


def _match_name(name: str, names: Iterable[str]) -> str | None:
    """The matching one of some names, ignoring case; an exact match comes first."""
    matches = [candidate for candidate in names if candidate.lower() == name.lower()]
    return name if name in matches else next(iter(matches), None)


@dataclass(frozen=True)
class Step:
    """A part of an agent's plan: the subgoals with this verb and object, or the whole plan."""

    agent: int
    verb: str | None = None
    object: str | None = None

    @property
    def names(self) -> Names:
        return ((self.object, None),) if self.object else ()

    def action_text(self, default: str) -> str:
        """`lift lid`; `default` where it is the whole plan."""
        return f"{self.verb} {self.object}" if self.verb else default

    @property
    def text(self) -> str:
        return agent_name(self.agent) + (f": {self.action_text('')}" if self.verb else "")

    @property
    def end_text(self) -> str:
        """Text of its end: `Agent_2 lifts lid`, or `Agent_2 has finished`."""
        action = f"{VERBS[self.verb].third_person} {self.object}" if self.verb else "has finished"
        return f"{agent_name(self.agent)} {action}"


@dataclass(frozen=True)
class LiesOn:
    """Event: an object has been put down on another object, or on the table."""

    object: str
    surface: str = TABLE

    @property
    def names(self) -> Names:
        return tuple((name, None) for name in (self.object, self.surface) if name != TABLE)

    @property
    def end_text(self) -> str:
        return f"{self.object} is on {'the ' if self.surface == TABLE else ''}{self.surface}"


Event = Step | LiesOn


class Words:
    """The parts of a matched sentence (groups of its pattern), looked up in the vocabulary of a task.

    `listed_under` are the agents under which an answer lists the sentence.
    """

    def __init__(
        self, parts: Mapping[str, str], text: str, vocabulary: Vocabulary, listed_under: tuple[int, ...] = ()
    ):
        self._parts, self.text, self.vocabulary, self._listed_under = parts, text, vocabulary, listed_under
        self._context = f"constraint {text!r}"

    def __contains__(self, part: str) -> bool:
        return part in self._parts

    def __getitem__(self, part: str) -> str:
        return self._parts[part]

    def agent(self, key: str = "") -> int:
        return self._agent_number(self._group("agent", key))

    def agents(self) -> tuple[int, ...]:
        """The agents that the sentence names; without any, those it is listed under, or else all."""
        agents = (
            map(self._agent_number, re.findall(AGENT, self["agents"]))
            if "agents" in self
            else self._listed_under
        )
        return self.require_two(tuple(dict.fromkeys(agents)) or self.vocabulary.agents)

    def pair(self) -> tuple[int, int]:
        """The agent of the sentence, and its other agent."""
        agent, other = self.require_two((self.agent(), self.agent("other")))
        return agent, other

    def require_two(self, agents: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(agents)) < 2:
            names = ", ".join(map(agent_name, dict.fromkeys(agents)))
            raise self.error(f"needs two different agents; it names {names or 'none'}")
        return agents

    def object(self, key: str = "") -> str:
        return self.vocabulary.object(object_name(self._group("object", key)), self._context)

    def point(self, name: str) -> str:
        return self.vocabulary.point(name, self["point"], self._context)

    def verb(self, key: str = "", contact: bool = False) -> str | None:
        """The subgoal verb that a word stands for; None where the sentence has none.

        `contact` is whether the sentence gives a point or a direction of contact. Raises ArgumentError for a
        word that means something else here.
        """
        if (word := self._parts.get(f"{key}_verb" if key else "verb")) is None:
            return None
        verb = next(verb for verb in VERBS.values() if word in verb.all_forms)
        if synonym := verb.ambiguous_synonym(word):
            name = self.object(key)
            if name.lower().rpartition("_")[2] != synonym.object_suffix and not (contact and synonym.contact):
                raise self.error(synonym.advice.format(object=name))
        return verb.name

    def direction(self) -> str:
        """The orientation of the gripper: perpendicular, vertical, horizontal or level."""
        words = {"from above": "vertical", "from the side": "horizontal"}
        return words.get(self["direction"], self["direction"].removesuffix("ly"))

    def step(self, key: str = "") -> Step:
        """The part of an agent's plan that the sentence names; the whole plan without a verb."""
        verb = self.verb(key)
        return Step(self.agent(key), verb, self.object(key)) if verb else Step(self.agent(key))

    def event(self, key: str = "") -> Event:
        if (f"{key}_surface" if key else "surface") in self:
            name, surface = self.object(key), object_name(self._group("surface", key))
            surface = surface if surface == TABLE else self.vocabulary.object(surface, self._context)
            if name == surface:
                raise self.error(f"is not possible: {name} does not lie on itself")
            return LiesOn(name, surface)
        return self.step(key)

    def seconds(self, default_s: float | None = None, largest_s: float = MAX_WAIT_S) -> float:
        return self.quantity("s", largest_s, default_s)

    def quantity(
        self, part: Quantity, largest: float, default: float | None = None, smallest: float = 0.0
    ) -> float:
        """A length in m, a time in s, an angle in deg or a speed in m/s; the default where none is given."""
        if part not in self and default is not None:
            return default
        value = quantity(part, self[part], self["unit"])
        if not smallest <= value <= largest:
            unit = "m/s" if part == "speed" else part
            bounds = f"{smallest:g} and {largest:g} {unit}"
            raise self.error(f"is not possible: {value:g} {unit} is not between {bounds}")
        return value

    def zone(self) -> tuple[Vector, Vector]:
        """The lowest and the highest corner of a box, m."""
        corners = [
            [float(number) + 0.0 for number in re.findall(NUMBER, self[key])] for key in ("low", "high")
        ]
        if max(abs(value) for corner in corners for value in corner) > ZONE_LIMIT_M:
            raise self.error(f"is not possible: zones lie within {ZONE_LIMIT_M:g} m of the origin")
        (x0, x1), (y0, y1), (z0, z1) = (sorted(pair) for pair in zip(*corners, strict=True))
        if min(x1 - x0, y1 - y0, z1 - z0) < 1e-3:
            raise self.error("is not possible: the zone is flat; each side must be at least 1 mm")
        return (x0, y0, z0), (x1, y1, z1)

    def error(self, why: str) -> ArgumentError:
        return ArgumentError(f"{self._context} {why}")

    def _group(self, name: str, key: str) -> str:
        return self._parts[f"{key}_{name}" if key else name]

    def _agent_number(self, agent: str) -> int:
        if agent == ANY_AGENT_TOKEN:
            return ANY_AGENT
        return self.vocabulary.agent(int(agent.removeprefix("agent_")), self._context)


_KINDS: list[type["Statement"]] = []


class Statement(ABC):
    """A constraint on a plan. Subclasses are frozen dataclasses, each registered when it is defined.

    `read(statement.sentence, ...)` returns an equal statement, for every kind.
    """

    kind: ClassVar[Kind]
    patterns: ClassVar[tuple[str, ...]]  # of its sentences: `rf_exp.statements.language.notation`
    samples: ClassVar[tuple["Statement", ...]]  # whose sentences are shown in prompts

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if "patterns" in cls.__dict__:
            _KINDS.append(cls)

    @property
    def agents(self) -> tuple[int, ...]:
        """The agents that it concerns, in the order of the sentence."""
        return tuple(part.agent for part in vars(self).values() if isinstance(part, Step))

    @property
    @abstractmethod
    def sentence(self) -> str: ...

    @property
    def names(self) -> Names:
        """The objects that it names, each with an interaction point where it names one."""
        own_object, parts = getattr(self, "object", None), vars(self).values()
        own_names = ((own_object, None),) if own_object else ()
        return *own_names, *(name for part in parts if isinstance(part, Event) for name in part.names)

    @classmethod
    def from_words(cls, words: Words) -> "Statement":
        """The statement of the words of a matched pattern. Raises ArgumentError where they make none."""
        raise NotImplementedError(f"{cls.__name__} does not say how its patterns are read")

    def checked_against(self, vocabulary: Vocabulary) -> Self:
        """Itself. Raises ArgumentError for an agent, object or point that the vocabulary does not have."""
        context = f"constraint {self.sentence!r}"
        for agent in self.agents:
            if agent != ANY_AGENT:
                vocabulary.agent(agent, context)
        for name, point in self.names:
            vocabulary.object(name, context)
            if point is not None:
                vocabulary.point(name, point, context)
        return self


@dataclass(frozen=True)
class OneAgentStatement(Statement):
    """A statement about one agent."""

    agent: int

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent, *super().agents)

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        return cls(words.agent())


@dataclass(frozen=True)
class MultiAgentStatement(Statement):
    """A statement about several agents."""

    who: tuple[int, ...]

    @property
    def agents(self) -> tuple[int, ...]:
        return self.who

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        return cls(words.agents())


def kinds() -> Iterator[type[Statement]]:
    return iter(_KINDS)


@dataclass(frozen=True)
class Proposal:
    """RoboBrain's answer: the next subgoals of each agent, and the constraints that must hold."""

    subgoals: tuple[Subgoal, ...]  # in the order of the plan; an agent's own are serial
    constraints: tuple[Statement, ...]

    def subgoals_of(self, agent: int) -> tuple[Subgoal, ...]:
        return tuple(subgoal for subgoal in self.subgoals if subgoal.agent == agent)
