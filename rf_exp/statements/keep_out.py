"""Spatial: an agent stays out of a zone (paper, section 3.2)."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.language.base import Form, Statement
from rf_exp.statements.language.events import Event, Step, named
from rf_exp.statements.language.notation import Vector, Words, vector
from rf_exp.statements.language.vocabulary import agent_name
from rf_exp.types import Kind


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


KeepOut.samples = (
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5)),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), occupied_by=2),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), until=Step(2, "lift", "lid")),
)
