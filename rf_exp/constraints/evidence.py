"""What a check is, and what it answers with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

from rf_exp.constraints.plan import Plan
from rf_exp.statements import agent_name
from rf_exp.types import Cause, Kind, Scene, Segment, Violation

CAUSES: Mapping[Kind, Cause] = {"logical": "interaction", "temporal": "time", "spatial": "space"}


@dataclass(frozen=True)
class Evidence:
    """The answer of a check: never a bare bool."""

    ok: bool
    value: float  # what was found, in the unit of the check
    bound: float  # what is allowed
    reason: str  # a sentence that a person and a model can act on
    time_s: float = 0.0  # since the start of the episode
    agents: tuple[int, ...] = ()  # those it is about, where these are not all agents of the check


class Check(Protocol):
    """One compiled constraint. Every implementation is a small frozen class."""

    kind: ClassVar[Kind]
    name: ClassVar[str]  # of the paper's validation function
    unit: ClassVar[str]  # of value and bound; empty for a share

    @property
    def agents(self) -> tuple[int, ...]: ...

    @property
    def text(self) -> str:
        """The constraint as it was stated."""
        ...

    def planned(self, plan: Plan) -> Evidence:
        """Judge trajectories and schedule before anything moves."""
        ...

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        """Judge the real state at one control step; None when there is nothing to judge now."""
        ...


def violation(check: Check, evidence: Evidence) -> Violation:
    """The failed check as feedback."""
    return Violation(
        check.name,
        CAUSES[check.kind],
        evidence.agents or check.agents,
        evidence.time_s,
        evidence.value,
        evidence.bound,
        evidence.reason,
    )


def names(agents: tuple[int, ...]) -> str:
    """`Agent_1` or `[Agent_1, Agent_2]`, as the paper prints check code."""
    listed = ", ".join(agent_name(agent) for agent in agents)
    return listed if len(agents) == 1 else f"[{listed}]"


def doing(segment: Segment | None) -> str:
    """What an agent is about in a segment, in words."""
    return "standing still" if segment is None else f"to {segment.subgoal.text} ({segment.primitive})"
