"""What checks find, as values: who, when, how much, what was in the way. Sentences are written from them.

Agents are numbered from 1. There is one clock: `time_s` is in seconds since the start of the episode.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import TypedDict

from rf_exp.findings.finding import Finding
from rf_exp.findings.words import Words, agent_name


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


@dataclass(frozen=True, kw_only=True)
class Found:
    """What was found. Each finding tells (`Finding`) which of the facts behind the numbers it has."""

    finding: Finding = Finding.CONSTRAINT
    value: float = 0.0  # what was found, in `unit`
    bound: float = 0.0  # what is allowed, in `unit`
    unit: str = ""  # empty for a share, and where there is no number
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
        said = self.finding.form.format_map(Words(self))
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
