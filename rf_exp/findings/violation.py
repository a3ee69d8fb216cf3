"""What checks find, as values: who, when, how much, what was in the way. Sentences are written from them.

Agents are numbered from 1. There is one clock: `time_s` is in seconds since the start of the episode.
"""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import TypedDict

from rf_exp.findings.finding import Finding


class CheckName(StrEnum):
    """Who found it: one of the paper's validation functions, the watch on execution, or the loop itself."""

    INTERACTION = "ValidateInteraction"
    DIRECTION = "ValidateDirection"
    SCHEDULING = "ValidateScheduling"
    OCCUPANCY = "ValidateSpatialOccupancy"
    COLLISION = "Collision"  # arms that have hit something
    TRACKING = "Tracking"  # an arm beside its path
    OBJECT_MOTION = "ObjectMotion"  # a disturbed arm that has moved a thing it is not about
    MOTION = "Motion"  # no motion was found for a proposal
    CODE = "CheckCode"  # constraints that no check code can be made of
    BRAIN = "RoboBrain"  # its answer is none


class Cause(StrEnum):
    """What a violation is about."""

    CONTACT = "contact"  # arms that hit something
    SPACE = "space"  # room for an arm
    TIME = "time"  # order and time
    REACH = "reach"  # what an arm can reach
    INTERACTION = "interaction"  # where and how it takes hold
    GRIP = "grip"  # what it holds
    TRACKING = "tracking"  # whether it follows its path
    ANSWER = "answer"  # the answer itself


@dataclass(frozen=True)
class Doing:
    """What an agent is about at a moment of its plan."""

    subgoal: str  # its text
    primitive: str
    along_s: float | None = None  # how long it has been on its own way, waiting left out, where that counts


@dataclass(frozen=True)
class Found:
    """What was found. Each finding tells (`Finding`) which of the facts behind the numbers it has."""

    finding: Finding = Finding.CONSTRAINT
    value: float = 0.0  # what was found, in `unit`
    bound: float = 0.0  # what is allowed, in `unit`
    unit: str = ""  # empty for a share, and where there is no number
    _: KW_ONLY
    time_s: float  # since the start of the episode
    agents: tuple[int, ...] = ()  # those it is about: two that are in each other's way, one that cannot reach
    measured: bool = False  # on the real state; otherwise planned, before anything moves
    obstacles: tuple[str, ...] = ()  # what was in the way: objects, agents, zones
    object: str | None = None  # the one that it is about
    aspect: str = ""  # of it, or of the agent: the point, direction, side or parts that are asked about
    doing: tuple[Doing | None, ...] = ()  # of each agent then; None: it stands still
    parts: tuple[str, ...] = ()  # the links and things that are nearest to one another
    subgoals: tuple[str, ...] = ()  # those that it is about
    known: tuple[str, ...] = ()  # what there is instead of what was named
    refusal: str = ""  # what the reader of an answer said of it
    constraint: str = ""  # as it was stated
    tried: tuple[str, ...] = ()  # the paths that were tried, where there is more than one way to plan

    @property
    def sentence(self) -> str:
        """One that a person and a model can act on."""
        said = self.finding.form.format_map(_Words(self))
        return f"{said}; paths were tried {', then '.join(self.tried)}" if self.tried else said


class About(TypedDict, total=False):
    """Facts of `Found` beside its numbers, for whoever passes them on."""

    agents: tuple[int, ...]
    measured: bool
    obstacles: tuple[str, ...]
    object: str | None
    aspect: str
    doing: tuple[Doing | None, ...]
    parts: tuple[str, ...]
    subgoals: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Violation(Found):
    """A check that failed, with the evidence."""

    check: CheckName
    cause: Cause

    @property
    def kind(self) -> str:
        """Without what differs from seed to seed: equal failures are equal texts."""
        who = " and ".join(map(agent_name, self.agents))
        about = self.obstacles or ((self.object,) if self.object else ())
        return ": ".join(filter(None, (who, f"{self.finding} {', '.join(about)}".strip())))


def agent_name(agent: int) -> str:
    """`Agent_1`, as the paper writes it."""
    return f"Agent_{agent}"


def names(agents: tuple[int, ...]) -> str:
    """`Agent_1` or `[Agent_1, Agent_2]`, as the paper prints check code."""
    listed = ", ".join(map(agent_name, agents))
    return listed if len(agents) == 1 else f"[{listed}]"


def _does(now: Doing | None) -> str:
    return "standing still" if now is None else f"to {now.subgoal} ({now.primitive})"


def _is(now: Doing | None) -> str:
    return "where it stands" if now is None else f"{now.along_s:.2f} s along its own way, {_does(now)}"


def _everyone(found: Found) -> str:
    """Each agent and what it does, where that is known."""
    if not found.doing:
        return names(found.agents)
    each = zip(found.agents, found.doing, strict=True)
    return ", and ".join(f"{agent_name(agent)}, {_does(does)}" for agent, does in each)


def _moves(found: Found) -> int:
    """Which of two agents is on its way."""
    return next((k for k, does in enumerate(found.doing) if does is not None), 0)


def _how_near(found: Found) -> str:
    """Which part comes how near to which part of what is in the way, where that is known."""
    if not found.parts:
        return ""
    where = f"{found.aspect} " if found.aspect else ""
    near = f"{found.value * 100:.1f} cm of {found.parts[1]}; at least {found.bound * 100:.1f} cm"
    return f" ({where}its {found.parts[0]} comes within {near})"


_WRITTEN: Mapping[str, Callable[[Found], object]] = {  # what forms name beside the facts as they are
    "agents": lambda found: names(found.agents),
    "a": lambda found: agent_name(found.agents[0]),
    "b": lambda found: agent_name(found.agents[1]),
    "both": lambda found: " and ".join(map(agent_name, found.agents[:2])),
    "everyone": _everyone,
    "a_does": lambda found: _does(found.doing[0]),
    "b_does": lambda found: _does(found.doing[1]),
    "a_is": lambda found: _is(found.doing[0]),
    "b_is": lambda found: _is(found.doing[1]),
    "state": lambda found: "as measured" if found.measured else _does(found.doing[0]),
    "meets": lambda found: "meets" if found.measured else "would meet",
    "blocked": lambda found: agent_name(found.agents[_moves(found)]),
    "blocked_is": lambda found: _is(found.doing[_moves(found)]),
    "parked": lambda found: agent_name(found.agents[1 - _moves(found)]),
    "at": lambda found: f"at {found.time_s:.2f} s",
    "cm": lambda found: found.value * 100,
    "bound_cm": lambda found: found.bound * 100,
    "mm": lambda found: found.value * 1000,
    "depth_mm": lambda found: -found.value * 1000,
    "first": lambda found: found.subgoals[0],
    "then": lambda found: found.subgoals[1],
    "listed": lambda found: "; ".join(found.subgoals) or "none",
    "names": lambda found: ", ".join(found.known) or "none",
    "obstacle": lambda found: found.obstacles[0],
    "in_the_way": lambda found: ", ".join(f"{each} is in the way" for each in found.obstacles),
    "how_near": _how_near,
}


class _Words:
    """What a form names, once it is asked for."""

    def __init__(self, found: Found) -> None:
        self._found = found

    def __getitem__(self, name: str) -> object:
        return _WRITTEN[name](self._found) if name in _WRITTEN else getattr(self._found, name)
