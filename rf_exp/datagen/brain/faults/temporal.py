"""Mistakes about order and time."""

from dataclasses import replace

import numpy as np

from rf_exp.datagen.brain.faults.fault import fault
from rf_exp.datagen.brain.faults.proposals import choose, orders, with_constraint
from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import Before, Deadline, Proposal, Step, Together

TOO_SOON_S = 0.1
APART_S = 5.0


@fault(breaks=True)
def swapped_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two consecutive subgoals of one agent are in the wrong order."""
    pairs = [
        pair
        for agent in question.task.agents
        for pair in zip(proposal.of(agent), proposal.of(agent)[1:], strict=False)
        if pair[0].verb == "grasp" and pair[1].object == pair[0].object
    ]
    pair = choose(pairs, rng)
    if pair is None:
        return None
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    return replace(proposal, subgoals=tuple(other.get(s, s) for s in proposal.subgoals))


@fault(breaks=True)
def circular_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An order is demanded both ways round."""
    order = choose(list(orders(proposal)), rng)
    if order is None:
        return None
    first, then = order
    return with_constraint(proposal, Before(then, first))


@fault(breaks=True)
def lost_synchronisation(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """One of two agents that must act together is told to wait for the other."""
    together = choose([c for c in proposal.constraints if isinstance(c, Together)], rng)
    if together is None:
        return None
    late, other = (int(agent) for agent in rng.permutation(together.agents[:2]))
    return with_constraint(proposal, Before(Step(other), Step(late), APART_S))


@fault(breaks=True)
def impossible_deadline(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to be finished before it can have moved."""
    movers = [s.agent for s in proposal.subgoals if s.verb not in ("hold", "home")]
    if not movers:
        return None
    chosen = int(rng.choice(movers))
    return with_constraint(proposal, Deadline(Step(chosen), TOO_SOON_S))


TEMPORAL = (swapped_order, circular_order, lost_synchronisation, impossible_deadline)
