"""Spatial: agents keep clear of one another and of objects (paper, section 3.2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.language.base import Form, OfAgent, OfAgents, Statement
from rf_exp.statements.language.notation import Words
from rf_exp.statements.language.vocabulary import agent_name, listed
from rf_exp.types import Kind


@dataclass(frozen=True)
class AvoidAgents(OfAgents):
    """One agent touches no other, or several do not touch one another."""

    kind: ClassVar[Kind] = "spatial"

    @property
    def sentence(self) -> str:
        first, *others = map(agent_name, self.who)
        if len(others) > 1:
            return f"{listed(self.who)} must avoid colliding with each other."
        return f"Avoid collision between {first} and {others[0] if others else 'other agents'}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        whom = r"(?:avoid {collisions} (?:between|of) {agent} (?:and|with)|{agent} {not} {collide with}) "
        each_other = (
            r"(?:{must} avoid (?:colliding|collisions?|contact) with each other|"
            r"{not} collide(?: with each other)?)"
        )
        return (
            Form(rf"{whom}{{others}}", lambda words: cls((words.agent(),))),
            Form(
                r"(?:avoid {collisions} between {agent} and|{agent} {must} avoid(?: {collisions} with)?) "
                r"{agent other}",
                cls._read_pair,
            ),
            Form(
                r"{agent} {not} (?:occupy the same space as|{collide with}|enter the space of) {agent other}",
                cls._read_pair,
            ),
            Form(rf"{{agents}} {each_other}", lambda words: cls(tuple(sorted(words.agents())))),
            Form(
                rf"(?:all )?(?:agents|robots|arms) {each_other}",
                lambda words: cls(tuple(sorted(words.everybody()))),
            ),
        )

    @classmethod
    def _read_pair(cls, words: Words) -> Statement:
        return cls(tuple(sorted(words.several((words.agent(), words.agent("other"))))))


@dataclass(frozen=True)
class AvoidObjects(OfAgent):
    """An agent touches nothing but what its subgoals are about."""

    kind: ClassVar[Kind] = "spatial"

    @property
    def sentence(self) -> str:
        return f"Avoid collision between {agent_name(self.agent)} and the objects."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"(?:avoid {collisions} (?:between|of) {agent} (?:and|with)|{agent} {not} {collide with}) "
                r"{things}",
                lambda words: cls(words.agent()),
            ),
        )


def keep_clear(agents: Iterable[int]) -> list[Statement]:
    """Nobody touches another agent, nor an object that its subgoals are not about."""
    agents = tuple(agents)
    return [*(AvoidAgents((agent,)) for agent in agents), *(AvoidObjects(agent) for agent in agents)]


AvoidAgents.samples = (AvoidAgents((1,)), AvoidAgents((1, 2)), AvoidAgents((1, 2, 3)))
AvoidObjects.samples = (AvoidObjects(1),)
