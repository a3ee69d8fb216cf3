"""Spatial: agents keep clear of one another and of objects (paper, section 3.2)."""

from collections.abc import Iterable
from dataclasses import dataclass

from rf_exp.statements.language.base import (
    MultiAgentStatement,
    OneAgentStatement,
    Statement,
    Words,
    agent_list,
    agent_name,
)

_AVOIDS = r"(?:avoid {collisions} (?:between|of) {agent} (?:and|with)|{agent} {not} {collide with})"
_EACH_OTHER = (
    r"(?:{must} avoid (?:colliding|collisions?|contact) with each other|"
    r"{not} collide(?: with each other)?)"
)


@dataclass(frozen=True)
class AvoidAgents(MultiAgentStatement):
    """One agent touches no other, or several do not touch one another."""

    kind = "spatial"
    patterns = (
        rf"{_AVOIDS} {{others}}",
        r"(?:avoid {collisions} between {agent} and|{agent} {must} avoid(?: {collisions} with)?) "
        r"{agent other}",
        r"{agent} {not} (?:occupy the same space as|{collide with}|enter the space of) {agent other}",
        rf"{{agents}} {_EACH_OTHER}",
        rf"(?:all )?(?:agents|robots|arms) {_EACH_OTHER}",
    )

    @property
    def sentence(self) -> str:
        first, *others = map(agent_name, self.who)
        if len(others) > 1:
            return f"{agent_list(self.who)} must avoid colliding with each other."
        return f"Avoid collision between {first} and {others[0] if others else 'other agents'}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        if "other_agent" in words:
            agents = words.pair()
        elif "agent" in words:
            agents = (words.agent(),)
        else:
            agents = words.agents() if "agents" in words else words.require_two(words.vocabulary.agents)
        return cls(tuple(sorted(agents)))


@dataclass(frozen=True)
class AvoidObjects(OneAgentStatement):
    """An agent touches no object except those of its subgoals."""

    kind = "spatial"
    patterns = (rf"{_AVOIDS} {{things}}",)

    @property
    def sentence(self) -> str:
        return f"Avoid collision between {agent_name(self.agent)} and the objects."


def keep_clear(agents: Iterable[int]) -> list[Statement]:
    """Statements that each agent avoids the others, and objects outside its subgoals."""
    agents = tuple(agents)
    return [*(AvoidAgents((agent,)) for agent in agents), *(AvoidObjects(agent) for agent in agents)]


AvoidAgents.samples = (AvoidAgents((1,)), AvoidAgents((1, 2)), AvoidAgents((1, 2, 3)))
AvoidObjects.samples = (AvoidObjects(1),)
