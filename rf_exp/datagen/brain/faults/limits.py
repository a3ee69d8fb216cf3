"""Limits that cannot be kept."""

import numpy as np

from rf_exp.datagen.brain.faults.fault import fault
from rf_exp.datagen.brain.faults.proposals import (
    apart_m,
    choose,
    contact_pose,
    contacts,
    goal_m,
    is_brought,
    with_constraint,
)
from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import Deadline, KeepApart, KeepHeight, KeepLevel, Proposal, SpeedLimit, Step

FAR_M = 1.6
UNDER_M = 0.02
CRAWLS_M_S, SOON_S = 0.02, 2.0  # 4 cm


@fault(breaks=True)
def impossible_distance(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two agents that work side by side are to keep their grippers farther apart than they can."""
    pairs = [
        (one.agent, other.agent)
        for one in contacts(proposal)
        for other in contacts(proposal)
        if one.agent < other.agent and apart_m(goal_m(one, question), goal_m(other, question)) < FAR_M / 2
    ]
    pair = choose(pairs, rng)
    return pair and with_constraint(proposal, KeepApart(pair, FAR_M))


@fault(breaks=True)
def impossible_tilt(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """What an agent puts somewhere may not be tilted at all, not even by what no such motion is without."""
    # A lift alone is no room for it: straight up, the tilt may be exactly none.
    chosen = choose([s for s in proposal.subgoals if s.verb == "place" and s.object], rng)
    return chosen and with_constraint(proposal, KeepLevel(chosen.object or "", 0.0, chosen.agent))


@fault(breaks=True)
def impossible_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to keep its gripper below the very point that it is to reach."""
    chosen = choose([s for s in contacts(proposal) if not is_brought(proposal, s)], rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    height_m = float(contact_pose(chosen.object, chosen.point, question)[2, 3])
    return with_constraint(proposal, KeepHeight(chosen.agent, max(0.0, round(height_m - UNDER_M, 3))))


@fault(breaks=True)
def impossible_speed(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to move very slowly, and to be done soon."""
    chosen = choose([s for s in contacts(proposal) if not is_brought(proposal, s)], rng)
    if chosen is None:
        return None
    slowly = with_constraint(proposal, SpeedLimit(chosen.agent, CRAWLS_M_S))
    return with_constraint(slowly, Deadline(Step(chosen.agent), SOON_S))


LIMITS = (impossible_distance, impossible_tilt, impossible_height, impossible_speed)
