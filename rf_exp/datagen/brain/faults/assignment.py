"""Mistakes about who does what, and with what."""

from dataclasses import replace

import numpy as np

from rf_exp.datagen.brain.faults.fault import fault
from rf_exp.datagen.brain.faults.proposals import choose, contacts, demands_point, exchanged, with_constraint
from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import AvoidAgents, Proposal, agent_name, understood


@fault(breaks=True)
def wrong_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two agents have each other's subgoals; the constraints still speak of the right ones."""
    agents = list(dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals))
    if len(agents) < 2 or not any(demands_point(proposal, s) for s in contacts(proposal)):
        return None
    first, second = (int(agent) for agent in rng.choice(agents, 2, replace=False))
    other = {first: second, second: first}
    swapped = tuple(replace(s, agent=other.get(s.agent, s.agent)) for s in proposal.subgoals)
    return None if set(swapped) == set(proposal.subgoals) else replace(proposal, subgoals=swapped)


@fault(breaks=True)
def unknown_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint speaks of an agent that is not there."""
    return with_constraint(proposal, AvoidAgents((len(question.task.agents) + 1,)))


@fault(breaks=True)
def missing_object(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A subgoal is about an object that is not there."""
    chosen = choose([s for s in proposal.subgoals if s.object], rng)
    return chosen and exchanged(proposal, chosen, replace(chosen, object=f"second_{chosen.object}"))


@fault(breaks=True)
def missing_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Something is to be put at a place that is not there."""
    chosen = choose([s for s in proposal.subgoals if s.target], rng)
    return chosen and exchanged(proposal, chosen, replace(chosen, target="nowhere", target_point=None))


@fault(breaks=False)
def missing_subgoal(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """The last subgoal of an agent is left out."""
    lasts = {subgoal.agent: subgoal for subgoal in proposal.subgoals}
    left_out = choose(list(lasts.values()), rng)
    if left_out is None or len(proposal.subgoals) < 2:
        return None
    return replace(proposal, subgoals=tuple(s for s in proposal.subgoals if s is not left_out))


@fault(breaks=False)
def missing_constraint(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """One constraint is left out."""
    left_out = choose(list(proposal.constraints), rng)
    return left_out and replace(
        proposal, constraints=tuple(c for c in proposal.constraints if c is not left_out)
    )


@fault(breaks=True)
def unreadable_constraint(
    proposal: Proposal, question: Question, rng: np.random.Generator
) -> Proposal | None:
    """A constraint is stated in words that no check stands for."""
    chosen = int(rng.choice(question.task.agents))
    text = f"{agent_name(chosen)} should mind its manners."
    return with_constraint(proposal, understood(text, question.task.vocabulary, "spatial", (chosen,)))


ASSIGNMENT = (
    wrong_agent,
    unknown_agent,
    missing_object,
    missing_target,
    missing_subgoal,
    missing_constraint,
    unreadable_constraint,
)
