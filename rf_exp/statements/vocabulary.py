"""What a task has to speak of: its agents, and its objects with their interaction points."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rf_exp.errors import choices
from rf_exp.findings import agent_name

TABLE = "table"  # what named places lie on


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

    def agent(self, number: int, where: str) -> int:
        """The agent of that number. Raises ArgumentError that names those there are."""
        if number not in self.agents:
            raise choices(f"agent in {where}:", agent_name(number), map(agent_name, self.agents))
        return number

    def object(self, name: str, where: str) -> str:
        """The object of that name. Raises ArgumentError that names those there are."""
        if name not in self.points:
            raise choices(f"object in {where}:", name, self.points)
        return name

    def point(self, name: str, point: str, where: str) -> str:
        """The interaction point of an object. Raises ArgumentError that names those there are."""
        point = {"centre": "center", "middle": "center"}.get(point, point)
        if point not in self.points[name]:
            raise choices(f"point of {name} in {where}:", point, self.points[name])
        return point

    def __str__(self) -> str:
        """All of it in a line, for the message of an error."""
        things = (f"{name} ({', '.join(points)})" if points else name for name, points in self.points.items())
        return (
            f"agents: {', '.join(map(agent_name, self.agents))}; "
            f"objects with their points: {', '.join(things) or 'none'}"
        )
