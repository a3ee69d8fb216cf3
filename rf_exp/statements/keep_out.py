from dataclasses import dataclass

from rf_exp.statements.language.base import (
    Event,
    Names,
    OneAgentStatement,
    Statement,
    Step,
    Words,
    agent_name,
)
from rf_exp.statements.language.notation import Vector, vector

_ZONE = (
    r"{agent} (?:(?:{must} )?(?:(?:stays?|keeps?) out of|avoids?)|{not} enters?)(?: the)? "
    r"(?:zone|box|region|area) {low} to {high}"
)
_INSIDE = r"(?: still)? is (?:still )?(?:there|in it|in there|inside)"


@dataclass(frozen=True)
class KeepOut(OneAgentStatement):
    """A keep-out zone: an agent, with what it carries, stays out of a box. Corners in metres, world frame.

    If given, only while an agent or an object is in it, or until an event is over (paper, section 3.2).
    """

    kind = "spatial"
    patterns = (
        _ZONE,
        rf"{_ZONE} (?:while|when|as long as) {{agent other}}{_INSIDE}",
        rf"{_ZONE} (?:while|when|as long as) {{object other}}{_INSIDE}",
        rf"{_ZONE} (?:until|before) {{ended until}}",
    )

    low_m: Vector
    high_m: Vector
    occupied_by: int | str | None = None  # an agent, or an object
    until: Event | None = None

    @property
    def agents(self) -> tuple[int, ...]:
        occupant = (self.occupied_by,) if isinstance(self.occupied_by, int) else ()
        return (*super().agents, *occupant)

    @property
    def names(self) -> Names:
        return *(((self.occupied_by, None),) if isinstance(self.occupied_by, str) else ()), *super().names

    @property
    def sentence(self) -> str:
        zone = f"{agent_name(self.agent)} must stay out of zone {vector(self.low_m)} to {vector(self.high_m)}"
        if self.occupied_by is not None:
            occupant = agent_name(self.occupied_by) if isinstance(self.occupied_by, int) else self.occupied_by
            return f"{zone} while {occupant} is in it."
        return f"{zone} until {self.until.end_text}." if self.until else f"{zone}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agent, zone = words.agent(), words.zone()
        if "other_agent" in words:
            return cls(agent, *zone, occupied_by=words.pair()[1])
        if "other_object" in words:
            return cls(agent, *zone, occupied_by=words.object("other"))
        if "until_agent" in words or "until_object" in words:
            until = words.event("until")
            if isinstance(until, Step):
                words.require_two((agent, until.agent))
            return cls(agent, *zone, until=until)
        return cls(agent, *zone)


KeepOut.samples = (
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5)),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), occupied_by=2),
    KeepOut(1, (-0.1, 0.2, 0.0), (0.1, 0.4, 0.5), until=Step(2, "lift", "lid")),
)
