"""What a task has to speak of: its agents, and its objects with their interaction points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from rf_exp.errors import choices
from rf_exp.findings import agent_name

TABLE = "table"  # what named places lie on
Names = tuple[tuple[str, str | None], ...]  # of objects, each with an interaction point where one is named
_SYNONYMS = {"centre": "center", "middle": "center"}  # of points


def listed(agents: tuple[int, ...]) -> str:
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

    def named(self, name: str) -> str | None:
        """The object of that name, whatever its case: sentences are read in lower case."""
        return _named(name, self.points)

    def agent(self, number: int, where: str) -> int:
        """The agent of that number. Raises ArgumentError that names those there are."""
        if number not in self.agents:
            raise choices(f"agent in {where}:", agent_name(number), map(agent_name, self.agents))
        return number

    def object(self, name: str, where: str) -> str:
        """The object of that name. Raises ArgumentError that names those there are."""
        found = self.named(name)
        if found is None:
            raise choices(f"object in {where}:", name, self.points)
        return found

    def point(self, name: str, point: str, where: str) -> str:
        """The interaction point of an object. Raises ArgumentError that names those there are."""
        points = self.points[name]
        found = _named(point, points) or _named(_SYNONYMS.get(point, point), points)
        if found is None:
            raise choices(f"point of {name} in {where}:", point, points)
        return found

    def __str__(self) -> str:
        """All of it in a line, for the message of an error."""
        things = (f"{name} ({', '.join(points)})" if points else name for name, points in self.points.items())
        return (
            f"agents: {', '.join(map(agent_name, self.agents))}; "
            f"objects with their points: {', '.join(things) or 'none'}"
        )


def _named(name: str, names: Iterable[str]) -> str | None:
    """The one that is so called; where case tells two apart, the one that is written so."""
    alike = [each for each in names if each.lower() == name.lower()]
    return name if name in alike else next(iter(alike), None)
