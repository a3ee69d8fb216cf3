"""Mistakes about room."""

from dataclasses import replace

import numpy as np

from rf_exp.datagen.brain.faults.fault import fault
from rf_exp.datagen.brain.faults.proposals import (
    apart_m,
    choose,
    contact_pose,
    contacts,
    exchanged,
    goal_m,
    is_brought,
    with_constraint,
)
from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import KeepOut, Proposal
from rf_exp.types import Subgoal

ZONE_HALF_M = 0.1
TOO_HIGH_M = 3.0
IN_THE_WAY_M = 0.1


@fault(breaks=True)
def through_arm(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent has to go through another arm, which grasps something there and is told no more."""
    options = [
        (parked, goes.agent)
        for parked in contacts(proposal)
        for goes in proposal.subgoals
        if parked.verb == "grasp" and goes.agent != parked.agent
        if not (is_brought(proposal, parked) or is_brought(proposal, goes))
        if apart_m(goal_m(parked, question), goal_m(goes, question)) < IN_THE_WAY_M
    ]
    option = choose(options, rng)
    if option is None:
        return None
    parked, goes = option
    subgoals = (parked, *proposal.of(goes))
    orders = tuple(c for c in proposal.constraints if c.kind != "temporal")
    return Proposal(subgoals, tuple(c for c in orders if set(c.agents) <= {parked.agent, goes}))


@fault(breaks=True)
def unreachable_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to lift something higher than its arm reaches."""
    lifts = [s for s in proposal.subgoals if s.verb == "lift"]
    if (lift := choose(lifts, rng)) is not None:
        return exchanged(proposal, lift, replace(lift, height_m=TOO_HIGH_M))
    last = {s.agent: s for s in proposal.subgoals}
    grasp = choose([s for s in last.values() if s.verb == "grasp"], rng)
    if grasp is None:
        return None
    lift = Subgoal(grasp.agent, "lift", grasp.object, height_m=TOO_HIGH_M)
    return replace(proposal, subgoals=(*proposal.subgoals, lift))


@fault(breaks=True)
def forbidden_zone(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint forbids the space around the very point that an agent is to reach."""
    chosen = choose([s for s in contacts(proposal) if not is_brought(proposal, s)], rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    centre = contact_pose(chosen.object, chosen.point, question)[:3, 3]
    low, high = (np.round(centre + side, 3) + 0.0 for side in (-ZONE_HALF_M, ZONE_HALF_M))
    return with_constraint(proposal, KeepOut(chosen.agent, tuple(low.tolist()), tuple(high.tolist())))


SPATIAL = (through_arm, unreachable_target, forbidden_zone)
