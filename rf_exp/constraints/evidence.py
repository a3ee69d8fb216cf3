"""What a check is, and what it answers with."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol

from rf_exp.constraints.plan import Plan
from rf_exp.findings import Cause, CheckName, Finding, Found, Violation
from rf_exp.types import Kind, Scene

CAUSES: Mapping[Kind, Cause] = {
    "logical": Cause.INTERACTION,
    "temporal": Cause.TIME,
    "spatial": Cause.SPACE,
}


@dataclass(frozen=True, kw_only=True)
class Evidence(Found):
    """The answer of a check: never a bare bool."""

    ok: bool


class Check(Protocol):
    """One compiled constraint. Every implementation is a small frozen class."""

    kind: ClassVar[Kind]
    name: ClassVar[CheckName]  # of the paper's validation function
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
    facts = {each.name: getattr(evidence, each.name) for each in fields(Found)}
    facts |= {"unit": evidence.unit or check.unit, "constraint": check.text}
    return Violation(check=CheckName(check.name), cause=CAUSES[check.kind], **facts)


def idle(plan: Plan, agents: tuple[int, ...], bound: float, value: float = 0.0) -> Evidence:
    """What a check answers where nothing in a plan is about it: it holds."""
    found = Finding.IDLE
    return Evidence(ok=True, finding=found, value=value, bound=bound, time_s=plan.begins_s, agents=agents)
