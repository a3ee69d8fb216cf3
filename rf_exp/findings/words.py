"""What the forms of findings name, written from the facts."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rf_exp.findings.violation import Doing, Found


class Words:
    """What forms name, written from the facts; only what is asked for."""

    def __init__(self, found: "Found") -> None:
        self._found = found

    def __getitem__(self, name: str) -> object:
        return getattr(self if hasattr(type(self), name) else self._found, name)

    @property
    def agents(self) -> str:
        return names(self._found.agents)

    @property
    def a(self) -> str:
        return agent_name(self._found.agents[0])

    @property
    def b(self) -> str:
        return agent_name(self._found.agents[1])

    @property
    def both(self) -> str:
        return f"{self.a} and {self.b}"

    @property
    def a_does(self) -> str:
        return doing(self._found.doing[0])

    @property
    def b_does(self) -> str:
        return doing(self._found.doing[1])

    @property
    def a_is(self) -> str:
        return _on_its_way(self._found.doing[0])

    @property
    def b_is(self) -> str:
        return _on_its_way(self._found.doing[1])

    @property
    def everyone(self) -> str:
        """Each agent and what it does, where that is known."""
        found = self._found
        if not found.doing:
            return self.agents
        each = zip(found.agents, found.doing, strict=True)
        return ", and ".join(f"{agent_name(agent)}, {doing(does)}" for agent, does in each)

    @property
    def state(self) -> str:
        return "as measured" if self._found.measured else self.a_does

    @property
    def meets(self) -> str:
        return "meets" if self._found.measured else "would meet"

    @property
    def _moves(self) -> int:
        """Which of two agents is on its way."""
        return next((k for k, does in enumerate(self._found.doing) if does is not None), 0)

    @property
    def blocked(self) -> str:
        return agent_name(self._found.agents[self._moves])

    @property
    def blocked_is(self) -> str:
        return _on_its_way(self._found.doing[self._moves])

    @property
    def parked(self) -> str:
        return agent_name(self._found.agents[1 - self._moves])

    @property
    def at(self) -> str:
        return f"at {self._found.time_s:.2f} s"

    @property
    def cm(self) -> float:
        return self._found.value * 100

    @property
    def bound_cm(self) -> float:
        return self._found.bound * 100

    @property
    def mm(self) -> float:
        return self._found.value * 1000

    @property
    def depth_mm(self) -> float:
        return -self.mm

    @property
    def first(self) -> str:
        return self._found.subgoals[0]

    @property
    def then(self) -> str:
        return self._found.subgoals[1]

    @property
    def listed(self) -> str:
        return "; ".join(self._found.subgoals) or "none"

    @property
    def names(self) -> str:
        return ", ".join(self._found.known) or "none"

    @property
    def obstacle(self) -> str:
        return self._found.obstacles[0]

    @property
    def how_near(self) -> str:
        """Which part comes how near to which part of what is in the way, where that is known."""
        found = self._found
        if not found.parts:
            return ""
        where = f"{found.aspect} " if found.aspect else ""
        a, b = found.parts
        return f" ({where}its {a} comes within {self.cm:.1f} cm of {b}; at least {self.bound_cm:.1f} cm)"

    @property
    def in_the_way(self) -> str:
        return ", ".join(f"{each} is in the way" for each in self._found.obstacles)


def agent_name(agent: int) -> str:
    """`Agent_1`, as the paper writes it."""
    return f"Agent_{agent}"


def names(agents: tuple[int, ...]) -> str:
    """`Agent_1` or `[Agent_1, Agent_2]`, as the paper prints check code."""
    listed = ", ".join(agent_name(agent) for agent in agents)
    return listed if len(agents) == 1 else f"[{listed}]"


def doing(now: "Doing | None") -> str:
    """What an agent is about, in words."""
    return "standing still" if now is None else f"to {now.subgoal} ({now.primitive})"


def _on_its_way(now: "Doing | None") -> str:
    if now is None:
        return "where it stands"
    return f"{now.along_s:.2f} s along its own way, {doing(now)}"
