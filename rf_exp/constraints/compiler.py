"""From statements to checks: what each demands of the plan at hand (paper, section 3.1).

A statement becomes a check only where it fits the plan: it speaks of subgoals that are there, and of the
points that they are about. `Check.compiled` of its kind says so.
"""

from rf_exp.constraints.evidence import Check, checked_kinds
from rf_exp.errors import ArgumentError
from rf_exp.statements import TABLE, VERBS, Event, LiesOn, Proposal, Statement, Step, agent_name
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

    Raises ArgumentError where it speaks of what is not there, or does not fit the plan, and TypeError for a
    kind that has no check.
    """
    known, kind = stated.known_in(task.vocabulary), checked_kinds().get(type(stated))
    if kind is None:
        raise TypeError(f"no check states that it is of {type(stated).__name__}")
    return kind.compiled(known, Plans(task, proposal, stated))
