"""Mistakes about where and how an object is met."""

from dataclasses import replace

import numpy as np

from rf_exp.datagen.brain.faults.fault import fault
from rf_exp.datagen.brain.faults.proposals import (
    choose,
    contact_pose,
    contacts,
    demands_point,
    exchanged,
    points_of,
    with_constraint,
)
from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import Direction, Proposal, SameHeight

UNEVEN_M = 0.06


@fault(breaks=True)
def wrong_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent grasps an object at another of its points than the constraint demands."""
    options = [
        replace(subgoal, point=other)
        for subgoal in contacts(proposal)
        if demands_point(proposal, subgoal)
        for other in points_of(question, subgoal)
        if other != subgoal.point
    ]
    wrong = choose(options, rng)
    return wrong and replace(
        proposal,
        subgoals=tuple(
            wrong if (s.agent, s.verb, s.object) == (wrong.agent, wrong.verb, wrong.object) else s
            for s in proposal.subgoals
        ),
    )


@fault(breaks=True)
def unknown_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A subgoal names an interaction point that its object does not have."""
    chosen = choose(contacts(proposal), rng)
    return chosen and exchanged(proposal, chosen, replace(chosen, point="nowhere"))


@fault(breaks=True)
def wrong_direction(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint demands another direction of approach than the annotated one."""
    chosen = choose(contacts(proposal), rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    approach = contact_pose(chosen.object, chosen.point, question)[:3, 2]
    direction = "horizontal" if abs(approach[2]) > np.cos(np.pi / 4) else "vertical"
    return with_constraint(proposal, Direction(chosen.agent, chosen.object, direction))


@fault(breaks=True)
def uneven_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """One of two agents that must stay level lifts higher than the other."""
    level = {agent for c in proposal.constraints if isinstance(c, SameHeight) for agent in c.agents}
    chosen = choose([s for s in proposal.subgoals if s.agent in level and s.height_m is not None], rng)
    if chosen is None or chosen.height_m is None:
        return None
    return exchanged(proposal, chosen, replace(chosen, height_m=chosen.height_m + UNEVEN_M))


LOGICAL = (wrong_point, unknown_point, wrong_direction, uneven_height)
