"""From statements to checks: what each demands of the plan at hand (paper, section 3.1).

A statement becomes a check only where it fits the plan: it speaks of subgoals that are there, and of the
points that they are about. A new kind of statement is compiled by a function registered with
`check_of.register`.
"""

from functools import singledispatch

from rf_exp.constraints.checks.avoidance import AvoidAgents, AvoidObjects
from rf_exp.constraints.checks.direction import ValidateDirection
from rf_exp.constraints.checks.distance import Distance
from rf_exp.constraints.checks.height import ConsistentHeight
from rf_exp.constraints.checks.interaction import ValidateInteraction
from rf_exp.constraints.checks.keep_out import StayOut
from rf_exp.constraints.checks.limits import Height, Speed, Tilt
from rf_exp.constraints.checks.temporal import Deadline, Sequential, ShareSpace, Simultaneous
from rf_exp.constraints.evidence import Check
from rf_exp.errors import ArgumentError
from rf_exp.statements import (
    TABLE,
    VERBS,
    Before,
    ContactAt,
    Direction,
    Event,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    LiesOn,
    PlaceAt,
    Proposal,
    SameHeight,
    SpeedLimit,
    Statement,
    Step,
    Together,
    agent_name,
)
from rf_exp.statements import AvoidAgents as AvoidAgentsStated
from rf_exp.statements import AvoidObjects as AvoidObjectsStated
from rf_exp.statements import Deadline as DeadlineStated
from rf_exp.statements import ShareSpace as ShareSpaceStated
from rf_exp.tasks import Task
from rf_exp.types import Subgoal


class Plans:
    """The subgoals that statements are about, and what is wrong where they do not fit."""

    def __init__(self, task: Task, proposal: Proposal, stated: Statement) -> None:
        self._task, self._proposal, self._stated = task, proposal, stated

    def contacts(self, agent: int, name: str) -> list[Subgoal]:
        """The agent's subgoals that meet an object."""
        mine = self._proposal.of(agent)
        return [each for each in mine if each.object == name and VERBS[each.verb].is_contact]

    def carriers(self, name: str) -> tuple[int, ...]:
        """The agents that have to do with an object; all where none has."""
        found = dict.fromkeys(each.agent for each in self._proposal.subgoals if each.object == name)
        return tuple(found) or self._task.agents

    def step(self, event: Event) -> Step:
        """The part of a plan that an event is the beginning or the end of; all of it without a verb."""
        if isinstance(event, LiesOn):
            return self._put_down(event)
        if event.verb is None or self._has(event.agent, event.verb, event.object):
            return event
        if event.verb == "release" and self._has(event.agent, "place", event.object):
            return Step(event.agent, "place", event.object)  # at the end of which it lets go
        raise self.no_subgoal(event.text, event.agent)

    def place(self, agent: int, name: str, target: str) -> None:
        """Raises ArgumentError unless the agent puts that object to that target."""
        wanted = "place", name, target
        if not any((each.verb, each.object, each.target) == wanted for each in self._proposal.of(agent)):
            raise self.no_subgoal(f"{agent_name(agent)}: place {name} to {target}", agent)

    def _has(self, agent: int, verb: str, name: str | None) -> bool:
        return any((each.verb, each.object) == (verb, name) for each in self._proposal.of(agent))

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
        return ArgumentError(f"constraint {self._stated.sentence!r} {why}")


def compiled(stated: Statement, task: Task, proposal: Proposal) -> Check:
    """The check of a statement about a plan.

    Raises ArgumentError where it speaks of what is not there, or does not fit the plan.
    """
    return check_of(stated.known_in(task.vocabulary), Plans(task, proposal, stated))


@singledispatch
def check_of(stated: Statement, plans: Plans) -> Check:
    """The check of a statement; a function for each kind."""
    raise TypeError(f"no check is registered for {type(stated).__name__}")


@check_of.register
def _(stated: ContactAt, plans: Plans) -> Check:
    planned = {each.point for each in plans.contacts(stated.agent, stated.object) if each.point}
    if planned and stated.point not in planned:
        raise plans.refused(
            f"demands point {stated.point}, but {agent_name(stated.agent)} is to meet {stated.object} at "
            f"{' and '.join(sorted(planned))}; change the subgoal or the constraint"
        )
    return ValidateInteraction(stated.agent, stated.object, stated.point, stated.sentence)


@check_of.register
def _(stated: PlaceAt, plans: Plans) -> Check:
    plans.place(stated.agent, stated.object, stated.target)
    return ValidateInteraction(stated.agent, stated.target, stated.point, stated.sentence)


@check_of.register
def _(stated: Direction, plans: Plans) -> Check:
    verb, phase = stated.verb, None
    if verb is not None and VERBS[verb].is_contact:
        planned = {each.verb for each in plans.contacts(stated.agent, stated.object)}
        if planned and verb not in planned:
            raise plans.no_subgoal(f"{agent_name(stated.agent)}: {verb} {stated.object}", stated.agent)
    elif verb is not None:
        phase = plans.step(Step(stated.agent, verb, stated.object))
    return ValidateDirection(stated.agent, stated.object, stated.direction, stated.sentence, phase)


@check_of.register
def _(stated: SameHeight, plans: Plans) -> Check:
    phase = tuple(map(plans.step, stated.phase)) if stated.verb else ()
    return ConsistentHeight(stated.agents, stated.sentence, phase)


@check_of.register
def _(stated: Before, plans: Plans) -> Check:
    first, then = plans.step(stated.first), plans.step(stated.then)
    if first.agent == then.agent:
        raise plans.refused(f"needs two different agents; it names {agent_name(then.agent)}")
    return Sequential(first, then, stated.wait_s, stated.sentence)


@check_of.register
def _(stated: Together, plans: Plans) -> Check:
    steps = tuple(plans.step(Step(agent, stated.verb, stated.object)) for agent in stated.agents)
    return Simultaneous(steps, stated.within_s, stated.sentence)


@check_of.register
def _(stated: DeadlineStated, plans: Plans) -> Check:
    return Deadline(plans.step(stated.step), stated.within_s, stated.sentence)


@check_of.register
def _(stated: ShareSpaceStated, plans: Plans) -> Check:
    return ShareSpace(stated.agents, stated.sentence)


@check_of.register
def _(stated: AvoidAgentsStated, plans: Plans) -> Check:
    return AvoidAgents(stated.agents, stated.sentence)


@check_of.register
def _(stated: AvoidObjectsStated, plans: Plans) -> Check:
    return AvoidObjects(stated.agents, stated.sentence)


@check_of.register
def _(stated: KeepApart, plans: Plans) -> Check:
    return Distance(stated.who, stated.at_least_m, stated.parts, stated.sentence)


@check_of.register
def _(stated: KeepLevel, plans: Plans) -> Check:
    carriers = plans.carriers(stated.object) if stated.agent is None else (stated.agent,)
    return Tilt(carriers, stated.object, stated.within_deg, stated.sentence)


@check_of.register
def _(stated: KeepHeight, plans: Plans) -> Check:
    return Height(stated.agent, stated.limit_m, stated.side, stated.sentence)


@check_of.register
def _(stated: SpeedLimit, plans: Plans) -> Check:
    return Speed(stated.agent, stated.at_most_m_s, stated.sentence)


@check_of.register
def _(stated: KeepOut, plans: Plans) -> Check:
    until = None if stated.until is None else plans.step(stated.until)
    if until is not None and until.agent == stated.agent:
        raise plans.refused(f"waits for {agent_name(stated.agent)} itself")
    return StayOut(
        stated.agent,
        stated.low_m,
        stated.high_m,
        stated.sentence,
        occupied_by=stated.occupied_by,
        until=until,
    )
