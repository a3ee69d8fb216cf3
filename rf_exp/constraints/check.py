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
from rf_exp.constraints.stl import Comparison, Execution, Signal, Specification, always, condition
from rf_exp.coordination import Rule
from rf_exp.errors import ArgumentError
from rf_exp.findings import About, Cause, CheckName, Finding, Found, Misread, Violation
from rf_exp.statements import TABLE, VERBS, Event, LiesOn, Proposal, Statement, Step, agent_name
from rf_exp.tasks import Task
from rf_exp.types import Kind, Scene, Subgoal

_CAUSES: Mapping[Kind, Cause] = {"logical": Cause.INTERACTION, "temporal": Cause.TIME, "spatial": Cause.SPACE}
_COMPARED: Mapping[str, Callable[..., bool]] = {"<=": operator.le, ">=": operator.ge, ">": operator.gt}
CHECKS: dict[type[Statement], type["Check"]] = {}  # kind of statement -> its check


@dataclass(frozen=True, kw_only=True)
class Evidence(Found):
    """Result of a check: never a bare bool."""

    ok: bool


class Check(ABC):
    """One compiled constraint. Every kind is a small frozen dataclass, registered when it is defined."""

    states: ClassVar[type[Statement]]  # the kind of statement that it is compiled from
    name: ClassVar[CheckName]  # of the paper's validation function
    unit: ClassVar[str]  # of value and bound; empty for a fraction

    agents: tuple[int, ...]
    text: str  # the constraint as it was stated

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        if "states" in cls.__dict__:
            CHECKS[cls.states] = cls

    @property
    def kind(self) -> Kind:
        """Logical, temporal or spatial, as its statement is."""
        return self.states.kind

    @classmethod
    def compiled(cls, stated: Statement, plans: "Plans") -> Self:
        """The check of a statement about these plans; fields of the same name are copied.

        Raises ArgumentError where the statement does not fit the plans.
        """
        make: Callable[..., Self] = cls
        shared = {each: getattr(stated, each) for each in signature(cls).parameters if hasattr(stated, each)}
        steps = {each: plans.step(event) for each, event in shared.items() if isinstance(event, Event)}
        return make(**{**shared, **steps, "text": stated.sentence})

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

    def found(
        self, ok: bool, finding: Finding, value: float, bound: float, time_s: float, **about: Unpack[About]
    ) -> Evidence:
        """Evidence about its agents, unless others are given; value and bound in its unit."""
        facts: About = {"agents": self.agents, **about}
        return Evidence(finding, value, bound, ok=ok, time_s=time_s, **facts)

    def idle(self, plan: Plan, bound: float, value: float = 0.0) -> Evidence:
        """Evidence where nothing in a plan concerns it: it holds."""
        return self.found(True, Finding.IDLE, value, bound, plan.begins_s)


class BoundedCheck(Check):
    """A check of a number against a bound, with separate bounds for planned and measured numbers."""

    finding: ClassVar[Finding]  # that it reports
    comparison: Comparison = "<="  # of the number with its bound
    bounds: tuple[float, float]  # planned, measured
    rounding: ClassVar[float] = 1.0  # factor on the bound, for rounding errors

    def worst(self, values: NDArray[np.float64]) -> int:
        """Index of the number (T,) that is nearest to the bound, or farthest beyond it; the first one."""
        return int(values.argmax() if self.comparison == "<=" else values.argmin())

    def judged(self, value: float, time_s: float, **about: Unpack[About]) -> Evidence:
        """Evidence of one number, planned unless `measured` is given."""
        bound = self.bounds[about.get("measured", False)]
        ok = bool(_COMPARED[self.comparison](value, bound * self.rounding))
        return self.found(ok, self.finding, float(value), bound, time_s, **about)

    def formula(self, name: str, how: str, when: tuple[str, str] = ("", "")) -> Specification:
        """Its STL form: a signal of the number, a condition `when` it counts; each a name and a meaning."""

        def value(execution: Execution) -> NDArray[np.float64]:
            return np.array([0.0 if each is None else each.value for each in execution.measured(self)])

        def judged(execution: Execution) -> NDArray[np.float64]:
            return condition(each is not None for each in execution.measured(self))

        gates = (Signal(when[0], "", when[1], judged),) if when[0] else ()
        number = Signal(name, self.unit, f"{how}; 0 at other steps" if gates else how, value)
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
    facts = {each.name: getattr(evidence, each.name) for each in fields(Found)}
    facts |= {"unit": evidence.unit or check.unit, "constraint": check.text}
    return Violation(check=CheckName(check.name), cause=_CAUSES[check.kind], **facts)


class Plans:
    """Looks up the subgoals that a statement refers to; makes the errors where it does not fit them."""

    def __init__(self, task: Task, proposal: Proposal, stated: Statement) -> None:
        self._task, self._proposal, self._stated = task, proposal, stated

    def contacts(self, agent: int, name: str) -> list[Subgoal]:
        """The agent's subgoals that make contact with an object."""
        mine = self._proposal.of(agent)
        return [each for each in mine if each.object == name and VERBS[each.verb].is_contact]

    def carriers(self, name: str) -> tuple[int, ...]:
        """The agents with subgoals on an object; all agents where none has one."""
        found = dict.fromkeys(each.agent for each in self._proposal.subgoals if each.object == name)
        return tuple(found) or self._task.agents

    def step(self, event: Event) -> Step:
        """The part of a plan that an event begins or ends; the whole plan without a verb."""
        if isinstance(event, LiesOn):
            return self._put_down(event)
        planned = [(each.verb, each.object) for each in self._proposal.of(event.agent)]
        if event.verb is None or (event.verb, event.object) in planned:
            return event
        if event.verb == "release" and ("place", event.object) in planned:
            return Step(event.agent, "place", event.object)  # ends with the release
        raise self.no_subgoal(event.text, event.agent)

    def place(self, agent: int, name: str, target: str) -> None:
        """Raises ArgumentError unless the agent has a subgoal to place the object at the target."""
        wanted = "place", name, target
        if not any((each.verb, each.object, each.target) == wanted for each in self._proposal.of(agent)):
            raise self.no_subgoal(f"{agent_name(agent)}: place {name} to {target}", agent)

    def _put_down(self, event: LiesOn) -> Step:
        places = [
            each for each in self._proposal.subgoals if (each.verb, each.object) == ("place", event.object)
        ]
        for each in reversed(places):
            on_table = each.target not in self._task.objects  # named places are on it
            if each.target == event.surface or (event.surface == TABLE and on_table):
                return Step(each.agent, "place", event.object)
        listed = "; ".join(f"{agent_name(each.agent)}: {each.text}" for each in places) or "none"
        raise self.refused(
            f"speaks of when {event.ended}, but no subgoal puts {event.object} there; those that put it "
            f"somewhere: {listed}"
        )

    def no_subgoal(self, what: str, agent: int) -> ArgumentError:
        listed = "; ".join(subgoal.text for subgoal in self._proposal.of(agent)) or "none"
        return self.refused(
            f"speaks of {what}, which is no subgoal of {agent_name(agent)}; its subgoals: {listed}"
        )

    def refused(self, why: str) -> ArgumentError:
        return Misread(f"constraint {self._stated.sentence!r} {why}", Finding.UNFITTING_CONSTRAINT)
