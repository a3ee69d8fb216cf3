"""What a check is, and what it answers with."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar, Self, Unpack

from rf_exp.constraints.plan import Paths, Plan
from rf_exp.coordination import Rule
from rf_exp.findings import About, Cause, CheckName, Finding, Found, Violation
from rf_exp.statements import Statement
from rf_exp.tasks import Task
from rf_exp.types import Kind, Scene

if TYPE_CHECKING:
    from rf_exp.constraints.compiler import Plans
    from rf_exp.constraints.stl import Specification

CAUSES: Mapping[Kind, Cause] = {
    "logical": Cause.INTERACTION,
    "temporal": Cause.TIME,
    "spatial": Cause.SPACE,
}
_CHECKS: dict[type[Statement], type["Check"]] = {}  # of each kind of statement


@dataclass(frozen=True, kw_only=True)
class Evidence(Found):
    """The answer of a check: never a bare bool."""

    ok: bool


class Check(ABC):
    """One compiled constraint. Every kind is a small frozen dataclass, known by being defined."""

    states: ClassVar[type[Statement]]  # the kind of statement that it is compiled from
    name: ClassVar[CheckName]  # of the paper's validation function
    unit: ClassVar[str]  # of value and bound; empty for a share

    agents: tuple[int, ...]
    text: str  # the constraint as it was stated

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if "states" in cls.__dict__:
            _CHECKS[cls.states] = cls

    @property
    def kind(self) -> Kind:
        """Logical, temporal or spatial, as its statement is."""
        return self.states.kind

    @classmethod
    @abstractmethod
    def compiled(cls, stated: Statement, plans: "Plans") -> Self:
        """The check of a statement about these plans. Raises ArgumentError where it does not fit them."""

    @abstractmethod
    def planned(self, plan: Plan) -> Evidence:
        """The verdict on trajectories and schedule before anything moves."""

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        """The verdict on the real state at one control step; None when there is nothing to judge now."""
        return None

    def rule(self, paths: Paths) -> Rule | None:
        """What timing has to do about it; None where it can do nothing."""
        return None

    @abstractmethod
    def stl(self, task: Task) -> "Specification":
        """Its form in signal temporal logic."""

    def found(
        self,
        ok: bool,
        finding: Finding,
        value: float,
        bound: float,
        time_s: float,
        **about: Unpack[About],
    ) -> Evidence:
        """Evidence about its agents, unless others are named; value and bound in its unit."""
        facts: About = {"agents": self.agents, **about}
        return Evidence(ok=ok, finding=finding, value=value, bound=bound, time_s=time_s, **facts)

    def idle(self, plan: Plan, bound: float, value: float = 0.0) -> Evidence:
        """What it answers where nothing in a plan is about it: it holds."""
        return self.found(True, Finding.IDLE, value, bound, plan.begins_s)


@dataclass(frozen=True)
class OneAgentCheck(Check):
    """A check of one agent."""

    agent: int

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)


def checked_kinds() -> Mapping[type[Statement], type[Check]]:
    """The check of every kind of statement that has one."""
    return dict(_CHECKS)


def violation(check: Check, evidence: Evidence) -> Violation:
    """The failed check as feedback."""
    facts = {each.name: getattr(evidence, each.name) for each in fields(Found)}
    facts |= {"unit": evidence.unit or check.unit, "constraint": check.text}
    return Violation(check=CheckName(check.name), cause=CAUSES[check.kind], **facts)
