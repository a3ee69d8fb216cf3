"""What every statement is: a frozen value that knows its sentence, and the patterns that are read as it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

from rf_exp.statements.language.notation import Words, compiled
from rf_exp.statements.language.vocabulary import Names, Vocabulary
from rf_exp.types import Kind, Subgoal


@dataclass(frozen=True)
class Form:
    """One way to say something: a pattern in the notation of `rf_exp.statements.language.notation`."""

    notation: str
    build: Callable[[Words], "Statement"]

    def match(self, sentence: str):
        """The match of a whole normalised sentence, or None."""
        return compiled(self.notation).fullmatch(sentence)


_KINDS: list[type["Statement"]] = []


class Statement(ABC):
    """A constraint on a plan. Subclasses are frozen dataclasses; each becomes known by being defined.

    `parse(statement.sentence)` gives the statement again: a law over all kinds.
    """

    kind: ClassVar[Kind]
    patterns: ClassVar[tuple[str, ...]]  # that are read as it, in the notation of forms
    samples: ClassVar[tuple["Statement", ...]]  # whose sentences stand in prompts

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if {"patterns", "forms"} & cls.__dict__.keys():
            _KINDS.append(cls)

    @property
    @abstractmethod
    def agents(self) -> tuple[int, ...]:
        """Those it is about, in the order of the sentence."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """It in English."""

    @property
    def names(self) -> Names:
        """The objects it speaks of, each with the interaction point where it names one."""
        return ()

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        """The ways to say such a statement: its patterns, all with one reading."""
        return tuple(Form(each, cls.reading) for each in cls.patterns)

    @classmethod
    def reading(cls, words: Words) -> "Statement":
        """The statement of the words that a pattern found. Raises ArgumentError where they make none."""
        raise NotImplementedError(f"{cls.__name__} does not say how its patterns are read")

    def known_in(self, vocabulary: Vocabulary) -> Self:
        """Itself. Raises ArgumentError for an agent, object or point that the vocabulary does not have."""
        where = f"constraint {self.sentence!r}"
        for agent in self.agents:
            vocabulary.agent(agent, where)
        for name, point in self.names:
            vocabulary.object(name, where)
            if point is not None:
                vocabulary.point(name, point, where)
        return self


@dataclass(frozen=True)
class OfAgent(Statement):
    """A statement about one agent."""

    agent: int

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    @classmethod
    def reading(cls, words: Words) -> Statement:
        return cls(words.agent())


@dataclass(frozen=True)
class OfAgents(Statement):
    """A statement about several agents."""

    who: tuple[int, ...]

    @property
    def agents(self) -> tuple[int, ...]:
        return self.who

    @classmethod
    def reading(cls, words: Words) -> Statement:
        return cls(words.agents())


def kinds() -> Iterator[type[Statement]]:
    """All kinds of statements that are known."""
    return iter(_KINDS)


@dataclass(frozen=True)
class Proposal:
    """RoboBrain's answer: what each agent does next, and the constraints that must hold."""

    subgoals: tuple[Subgoal, ...]  # in the order of the plan; an agent's own are serial
    constraints: tuple[Statement, ...]

    def of(self, agent: int) -> tuple[Subgoal, ...]:
        return tuple(subgoal for subgoal in self.subgoals if subgoal.agent == agent)
