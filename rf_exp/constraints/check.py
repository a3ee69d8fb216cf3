"""Base classes of checks, their compilation from statements (paper, section 3.1), and their evidence."""

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from inspect import signature
from typing import ClassVar, Self, Unpack

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.plan import Paths, Plan
from rf_exp.constraints.stl import Comparison, Execution, Signal, Specification, always, condition_values
from rf_exp.coordination import Rule
from rf_exp.errors import ArgumentError
from rf_exp.findings import Cause, CheckName, FactArguments, Finding, FindingFacts, ParseError, Violation
from rf_exp.statements import TABLE, VERBS, Event, LiesOn, Proposal, Statement, Step, agent_name
from rf_exp.tasks import Task
from rf_exp.types import Kind, Scene, Subgoal

_CAUSES: Mapping[Kind, Cause] = {"logical": Cause.INTERACTION, "temporal": Cause.TIME, "spatial": Cause.SPACE}
_OPERATORS: Mapping[str, Callable[..., bool]] = {"<=": operator.le, ">=": operator.ge, ">": operator.gt}
CHECKS: dict[type[Statement], type["Check"]] = {}  # kind of statement -> its check


@dataclass(frozen=True, kw_only=True)
class Evidence(FindingFacts):
    """Result of a check: never a bare bool."""

    ok: bool


class Check(ABC):
    """One compiled constraint. Every kind is a small frozen dataclass, registered when it is defined."""

    statement_type: ClassVar[type[Statement]]  # the kind of statement that it is compiled from
    name: ClassVar[CheckName]  # of the paper's validation function
    unit: ClassVar[str]  # of value and bound; empty for a fraction

    agents: tuple[int, ...]
    text: str  # the constraint as it was stated

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if "statement_type" in cls.__dict__:
            CHECKS[cls.statement_type] = cls

    @property
    def kind(self) -> Kind:
        """Logical, temporal or spatial, as its statement is."""
        return self.statement_type.kind

    @classmethod
    def from_statement(cls, statement: Statement, context: "PlanContext") -> Self:
        """The check of a statement about these plans; fields of the same name are copied.

        Raises ArgumentError where the statement does not fit the plans.
        """
        constructor: Callable[..., Self] = cls
        arguments = {
            name: getattr(statement, name) for name in signature(cls).parameters if hasattr(statement, name)
        }
        steps = {name: context.step(event) for name, event in arguments.items() if isinstance(event, Event)}
        return constructor(**{**arguments, **steps, "text": statement.sentence})

    @abstractmethod
    def planned(self, plan: Plan) -> Evidence:
        """The verdict on trajectories and schedule before execution."""

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        """The verdict on the measured state of one control step; None when there is nothing to judge."""
        return None

    def rule(self, paths: Paths) -> Rule | None:
        """Its rule for the schedule; None where timing cannot help."""
        return None

    @abstractmethod
    def stl(self, task: Task) -> Specification:
        """Its form in signal temporal logic."""

    def make_evidence(
        self,
        ok: bool,
        finding: Finding,
        value: float,
        bound: float,
        time_s: float,
        **arguments: Unpack[FactArguments],
    ) -> Evidence:
        """Evidence about its agents, unless others are given; value and bound in its unit."""
        facts: FactArguments = {"agents": self.agents, **arguments}
        return Evidence(finding, value, bound, ok=ok, time_s=time_s, **facts)

    def not_applicable(self, plan: Plan, bound: float, value: float = 0.0) -> Evidence:
        """Evidence where nothing in a plan concerns it: it holds."""
        return self.make_evidence(True, Finding.IDLE, value, bound, plan.begins_s)


class BoundedCheck(Check):
    """A check of a number against a bound, with separate bounds for planned and measured numbers."""

    finding: ClassVar[Finding]  # that it reports
    comparison: Comparison = "<="  # of the number with its bound
    bounds: tuple[float, float]  # planned, measured
    rounding: ClassVar[float] = 1.0  # factor on the bound, for rounding errors

    def worst(self, values: NDArray[np.float64]) -> int:
        """Index of the number (T,) that is nearest to the bound, or farthest beyond it; the first one."""
        return int(values.argmax() if self.comparison == "<=" else values.argmin())

    def evidence_for(self, value: float, time_s: float, **arguments: Unpack[FactArguments]) -> Evidence:
        """Evidence of one number, planned unless `measured` is given."""
        bound = self.bounds[arguments.get("measured", False)]
        ok = bool(_OPERATORS[self.comparison](value, bound * self.rounding))
        return self.make_evidence(ok, self.finding, float(value), bound, time_s, **arguments)

    def formula(self, name: str, description: str, gate: tuple[str, str] = ("", "")) -> Specification:
        """Its STL form: a signal of the number, a condition `when` it counts; each a name and a meaning."""

        def values(execution: Execution) -> NDArray[np.float64]:
            return np.array(
                [0.0 if evidence is None else evidence.value for evidence in execution.measured(self)]
            )

        def applies(execution: Execution) -> NDArray[np.float64]:
            return condition_values(evidence is not None for evidence in execution.measured(self))

        gates = (Signal(gate[0], "", gate[1], applies),) if gate[0] else ()
        number = Signal(name, self.unit, f"{description}; 0 at other steps" if gates else description, values)
        margin = f"{name} {self.comparison} {self.bounds[True] * self.rounding!r}"
        formula = always([margin], self.unit, *gates, strict=self.comparison == ">")
        return Specification((formula,), (number, *gates))


@dataclass(frozen=True)
class OneAgentCheck(Check):
    """A check of one agent."""

    agent: int

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)


def violation(check: Check, evidence: Evidence) -> Violation:
    """The failed check as feedback."""
    facts = {field.name: getattr(evidence, field.name) for field in fields(FindingFacts)}
    facts |= {"unit": evidence.unit or check.unit, "constraint": check.text}
    return Violation(check=CheckName(check.name), cause=_CAUSES[check.kind], **facts)


class PlanContext:
    """Looks up the subgoals that a statement refers to; makes the errors where it does not fit them."""

    def __init__(self, task: Task, proposal: Proposal, statement: Statement) -> None:
        self._task, self._proposal, self._statement = task, proposal, statement

    def contact_subgoals(self, agent: int, name: str) -> list[Subgoal]:
        """The agent's subgoals that make contact with an object."""
        own_subgoals = self._proposal.subgoals_of(agent)
        return [
            subgoal for subgoal in own_subgoals if subgoal.object == name and VERBS[subgoal.verb].is_contact
        ]

    def carrying_agents(self, name: str) -> tuple[int, ...]:
        """The agents with subgoals on an object; all agents where none has one."""
        agents = dict.fromkeys(subgoal.agent for subgoal in self._proposal.subgoals if subgoal.object == name)
        return tuple(agents) or self._task.agents

    def step(self, event: Event) -> Step:
        """The part of a plan that an event begins or ends; the whole plan without a verb."""
        if isinstance(event, LiesOn):
            return self._placing_step(event)
        planned = [(subgoal.verb, subgoal.object) for subgoal in self._proposal.subgoals_of(event.agent)]
        if event.verb is None or (event.verb, event.object) in planned:
            return event
        if event.verb == "release" and ("place", event.object) in planned:
            return Step(event.agent, "place", event.object)  # ends with the release
        raise self.missing_subgoal_error(event.text, event.agent)

    def require_place_subgoal(self, agent: int, name: str, target: str) -> None:
        """Raises ArgumentError unless the agent has a subgoal to place the object at the target."""
        wanted = "place", name, target
        if not any(
            (subgoal.verb, subgoal.object, subgoal.target) == wanted
            for subgoal in self._proposal.subgoals_of(agent)
        ):
            raise self.missing_subgoal_error(f"{agent_name(agent)}: place {name} to {target}", agent)

    def _placing_step(self, event: LiesOn) -> Step:
        places = [
            subgoal
            for subgoal in self._proposal.subgoals
            if (subgoal.verb, subgoal.object) == ("place", event.object)
        ]
        for subgoal in reversed(places):
            on_table = subgoal.target not in self._task.objects  # named places are on it
            if subgoal.target == event.surface or (event.surface == TABLE and on_table):
                return Step(subgoal.agent, "place", event.object)
        listed = "; ".join(f"{agent_name(subgoal.agent)}: {subgoal.text}" for subgoal in places) or "none"
        raise self.error(
            f"speaks of when {event.end_text}, but no subgoal puts {event.object} there; those that put it "
            f"somewhere: {listed}"
        )

    def missing_subgoal_error(self, description: str, agent: int) -> ArgumentError:
        listed = "; ".join(subgoal.text for subgoal in self._proposal.subgoals_of(agent)) or "none"
        return self.error(
            f"speaks of {description}, which is no subgoal of {agent_name(agent)}; its subgoals: {listed}"
        )

    def error(self, why: str) -> ArgumentError:
        return ParseError(f"constraint {self._statement.sentence!r} {why}", Finding.UNFITTING_CONSTRAINT)
