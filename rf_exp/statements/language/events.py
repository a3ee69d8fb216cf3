"""Moments of a plan that statements speak of: when an agent begins or ends something, when a thing lies."""

from dataclasses import dataclass

from rf_exp.statements.language.verbs import VERBS
from rf_exp.statements.language.vocabulary import TABLE, Names, agent_name


@dataclass(frozen=True)
class Step:
    """A part of an agent's plan: the subgoals with this verb and object, or all of it."""

    agent: int
    verb: str | None = None
    object: str | None = None

    @property
    def names(self) -> Names:
        """The objects that it speaks of, as `Statement.names` has them."""
        return ((self.object, None),) if self.object else ()

    @property
    def text(self) -> str:
        return f"{agent_name(self.agent)}: {self.verb} {self.object}" if self.verb else agent_name(self.agent)

    @property
    def must(self) -> str:
        """`Agent_2 must lift lid`, or `Agent_2 must complete its task`."""
        what = f"{self.verb} {self.object}" if self.verb else "complete its task"
        return f"{agent_name(self.agent)} must {what}"

    @property
    def begins(self) -> str:
        """`Agent_1 may place steak`, or `Agent_1 begins`."""
        return agent_name(self.agent) + (f" may {self.verb} {self.object}" if self.verb else " begins")

    @property
    def ended(self) -> str:
        """`Agent_2 lifts lid`, or `Agent_2 has finished`: over from then on."""
        what = f"{VERBS[self.verb].third_person} {self.object}" if self.verb else "has finished"
        return f"{agent_name(self.agent)} {what}"


@dataclass(frozen=True)
class LiesOn:
    """An object has been put down where it belongs: on another object, or on the table."""

    object: str
    surface: str = TABLE

    @property
    def names(self) -> Names:
        """The objects that it speaks of, as `Statement.names` has them."""
        return tuple((name, None) for name in (self.object, self.surface) if name != TABLE)

    @property
    def text(self) -> str:
        return self.ended

    @property
    def ended(self) -> str:
        return f"{self.object} is on {'the ' if self.surface == TABLE else ''}{self.surface}"


Event = Step | LiesOn
