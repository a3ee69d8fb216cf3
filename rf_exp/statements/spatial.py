"""Spatial statements: who keeps clear of what, and where nobody may be (paper, section 3.2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.base import Form, OfAgent, OfAgents, Statement
from rf_exp.statements.events import Event, Step, named
from rf_exp.statements.notation import Vector, Words, vector
from rf_exp.statements.vocabulary import agent_name, listed
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


@dataclass(frozen=True)
class KeepOut(Statement):
    """A keep-out zone: an agent, with what it carries, stays out of a box. Corners in metres, world frame.

    Only while an agent or an object is in it, or until something is over, where one of them is given.
    """

    kind: ClassVar[Kind] = "spatial"

    agent: int
    low_m: Vector
    high_m: Vector
    occupied_by: int | str | None = None  # an agent, or an object
    until: Event | None = None

    @property
    def agents(self) -> tuple[int, ...]:
        others = [self.occupied_by] if isinstance(self.occupied_by, int) else []
        others += [self.until.agent] if isinstance(self.until, Step) else []
        return (self.agent, *others)

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        occupied = ((self.occupied_by, None),) if isinstance(self.occupied_by, str) else ()
        return *occupied, *(named(self.until) if self.until else ())

    @property
    def sentence(self) -> str:
        zone = f"{agent_name(self.agent)} must stay out of zone {vector(self.low_m)} to {vector(self.high_m)}"
        if self.occupied_by is not None:
            who = agent_name(self.occupied_by) if isinstance(self.occupied_by, int) else self.occupied_by
            return f"{zone} while {who} is in it."
        return f"{zone} until {self.until.ended}." if self.until else f"{zone}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        zone = (
            r"{agent} (?:(?:{must} )?(?:(?:stays?|keeps?) out of|avoids?)|{not} enters?)(?: the)? "
            r"(?:zone|box|region|area) {low} to {high}"
        )
        inside = r"(?: still)? is (?:still )?(?:there|in it|in there|inside)"
        return (
            Form(zone, cls._read),
            Form(rf"{zone} (?:while|when|as long as) {{agent other}}{inside}", cls._read),
            Form(rf"{zone} (?:while|when|as long as) {{object other}}{inside}", cls._read),
            Form(rf"{zone} (?:until|before) {{ended until}}", cls._read),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        agent, (low_m, high_m) = words.agent(), words.zone()
        if "other_agent" in words:
            other = words.agent("other")
            words.several((agent, other))
            return cls(agent, low_m, high_m, other)
        if "other_object" in words:
            return cls(agent, low_m, high_m, words.object("other"))
        if any(f"until_{part}" in words for part in ("agent", "object")):
            until = words.event("until")
            if isinstance(until, Step):
                words.several((agent, until.agent))
            return cls(agent, low_m, high_m, until=until)
        return cls(agent, low_m, high_m)


def keep_clear(agents: Iterable[int]) -> list[Statement]:
    """Nobody touches another agent, nor an object that its subgoals are not about."""
    agents = tuple(agents)
    return [*(AvoidAgents((agent,)) for agent in agents), *(AvoidObjects(agent) for agent in agents)]


AvoidAgents.samples = (AvoidAgents((1,)), AvoidAgents((1, 2)), AvoidAgents((1, 2, 3)))
AvoidObjects.samples = (AvoidObjects(1),)
KeepOut.samples = (
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5)),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), occupied_by=2),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), until=Step(2, "lift", "lid")),
)
