"""Queues of subgoals, one an agent: which of them is planned next.

A plan is a set of such queues: in which order it lists its agents says nothing. A queue waits while something
that must be over first has not been planned, and while something is in its way, or out of its reach, that
another queue may still move.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

from rf_exp.datagen.motion.state import Unreachable
from rf_exp.findings import Cause, Finding, agent_name
from rf_exp.statements import Proposal
from rf_exp.types import Subgoal

Lockstep = Collection[tuple[frozenset[int], str, str]]  # agents, verb, object: done as one motion
Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all that the agent does
Order = Collection[tuple[Part, Part]]  # the first is over before the second begins


@dataclass(frozen=True)
class _Stuck:
    """Why the next subgoal of an agent has no motion as things are."""

    error: Unreachable
    by: frozenset[str] | None  # things of which one has to move before it may have; None: or an arm
    moved: bool = False  # whether one has


def in_turn(proposal: Proposal, order: Order) -> Proposal:
    """The same plan for every order in which it may list its agents.

    First come agents that wait for nobody who is left, of several the one with the lowest number: so what
    others meet stands already where it will stand when they do.
    """
    left, listed = sorted({subgoal.agent for subgoal in proposal.subgoals}), []
    while left:
        waiting = {then[0] for first, then in order if first[0] in left and first[0] != then[0]}
        agent = next((each for each in left if each not in waiting), left[0])
        left.remove(agent)
        listed += proposal.of(agent)
    return replace(proposal, subgoals=tuple(listed))


class Queues:
    """What is still to be planned. Of agents that can go on the one that is listed first does."""

    def __init__(self, proposal: Proposal, lockstep: Lockstep, order: Order) -> None:
        agents = dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals)
        self._left = {agent: list(proposal.of(agent)) for agent in agents}
        self._lockstep, self._order = lockstep, order
        self._stuck: dict[int, _Stuck] = {}

    def next(self) -> Sequence[Subgoal]:
        """The subgoal that is planned next, or those of several agents that are one motion; none: all are.

        Raises Unreachable where nobody can go on: with the reason of the first that is stuck.
        """
        fronts = {agent: queue[0] for agent, queue in self._left.items() if queue}
        if not fronts:
            return ()
        ready = [each for each in fronts.values() if each.agent not in self._stuck and not self._waits(each)]
        alone = next((each for each in ready if self._group(each) is None), None)
        found = [alone] if alone is not None else self._together(ready)
        if found:
            return found
        still = {agent: each for agent, each in self._stuck.items() if not each.moved}
        if len(still) < len(self._stuck):
            self._stuck = still
            return self.next()
        for each in still.values():
            raise each.error
        circle = tuple(f"{agent_name(agent)}: {front.text}" for agent, front in fronts.items())
        raise Unreachable(Cause.TIME, Finding.CIRCLE, tuple(fronts), subgoals=circle)

    def following(self, agent: int) -> Sequence[Subgoal]:
        """What comes after the next subgoal of an agent."""
        return self._left[agent][1:]

    def of_others(self, agent: int) -> Sequence[Subgoal]:
        """What all the others have still to do."""
        return [each for other, queue in self._left.items() if other != agent for each in queue]

    def planned(self, subgoals: Sequence[Subgoal], moved: Collection[str]) -> None:
        """They have a motion, by which things are moved."""
        for each in subgoals:
            self._left[each.agent].pop(0)
        for agent, each in self._stuck.items():
            if each.by is None or each.by.intersection(moved):
                self._stuck[agent] = replace(each, moved=True)

    def stuck(self, subgoals: Sequence[Subgoal], error: Unreachable) -> None:
        """They have none as things are, and wait while others go on. Raises what no other can help."""
        if error.cause is Cause.REACH:
            by = frozenset[str]().union(*(each.names for each in subgoals))
        elif error.cause is Cause.SPACE:
            alone = "obstacles" in error.facts and error.agents[1:] == ()
            by = frozenset(error.facts["obstacles"]) if alone else None
        else:
            raise error
        self._stuck |= {each.agent: _Stuck(error, by) for each in subgoals}

    def done(self, agent: int) -> bool:
        """Whether an agent has nothing more to do."""
        return not self._left[agent]

    def _waits(self, subgoal: Subgoal) -> bool:
        """Whether something that must be over before this subgoal has not been planned yet."""
        return any(
            _is_of(then, subgoal) and any(map(partial(_is_of, first), self._left.get(first[0], ())))
            for first, then in self._order
        )

    def _group(self, subgoal: Subgoal) -> frozenset[int] | None:
        """The agents that carry out this subgoal as one motion, if it is such a one."""
        for agents, verb, name in self._lockstep:
            if subgoal.agent in agents and (subgoal.verb, subgoal.object) == (verb, name) and verb == "lift":
                return agents
        return None

    def _together(self, ready: Sequence[Subgoal]) -> Sequence[Subgoal]:
        """The joint subgoal that all its agents have come to."""
        for first in ready:
            agents, what = self._group(first), (first.verb, first.object)
            members = [
                each for each in ready if each.agent in (agents or ()) and what == (each.verb, each.object)
            ]
            if {each.agent for each in members} == agents:
                return members
        return ()


def _is_of(part: Part, subgoal: Subgoal) -> bool:
    agent, verb, name = part
    return subgoal.agent == agent and (verb is None or (subgoal.verb, subgoal.object) == (verb, name))
