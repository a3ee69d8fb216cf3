"""Named faults of proposals. Each takes a sound proposal and inserts one mistake."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain.protocol import Question
from rf_exp.errors import unknown_choice
from rf_exp.statements import (
    VERBS,
    AvoidAgents,
    Before,
    ContactAt,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    Proposal,
    SameHeight,
    SpeedLimit,
    Statement,
    Step,
    Together,
    agent_name,
    read_or_unparsed,
)
from rf_exp.transforms import Matrix
from rf_exp.types import Subgoal

UNEVEN_M = 0.06
TOO_SOON_S = 0.1
WAIT_S = 5.0
ZONE_HALF_M = 0.1
TOO_HIGH_M = 3.0
IN_THE_WAY_M = 0.1
FAR_M = 1.6
BELOW_M = 0.02
CRAWL_M_S, SOON_S = 0.02, 2.0  # together 4 cm

T = TypeVar("T")
Change = Callable[[Proposal, Question, np.random.Generator], Proposal]


class _NotApplicable(Exception):
    """Raised for a proposal that does not admit the fault."""


@dataclass(frozen=True)
class Fault:
    """A named mistake."""

    name: str
    insert: Change
    breaks: bool  # True: a demand cannot be met; False: a demand is left out

    def change(self, proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
        """The proposal with the fault in it; None where it does not admit the fault."""
        try:
            return self.insert(proposal, question, rng)
        except _NotApplicable:
            return None


FAULTS: dict[str, Fault] = {}


def fault(insert: Change, *, breaks: bool = True) -> Change:
    """Decorator that registers a function as the fault of the same name."""
    name = insert.__name__  # pyright: ignore[reportFunctionMemberAccess]
    FAULTS[name] = Fault(name, insert, breaks)
    return insert


def fault_named(fault: str) -> Fault:
    """The fault of that name. Raises ArgumentError that lists all names."""
    if fault not in FAULTS:
        raise unknown_choice("fault", fault, FAULTS)
    return FAULTS[fault]


# -- contacts
@fault
def wrong_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent grasps an object at another of its points than the constraint demands."""
    options = [
        replace(subgoal, point=other)
        for subgoal in contacts(proposal)
        if demands_point(proposal, subgoal)
        for other, point in question.task.asset(subgoal.object or "").points.items()
        if point.kind == subgoal.verb and other != subgoal.point
    ]
    wrong = choose(options, rng)
    key = wrong.agent, wrong.verb, wrong.object
    subgoals = (wrong if (s.agent, s.verb, s.object) == key else s for s in proposal.subgoals)
    return replace(proposal, subgoals=tuple(subgoals))


@fault
def unknown_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A subgoal names an interaction point that its object does not have."""
    chosen = choose(contacts(proposal), rng)
    return with_subgoal(proposal, chosen, replace(chosen, point="nowhere"))


@fault
def wrong_direction(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A constraint demands another direction of approach than the annotated one."""
    chosen = choose(contacts(proposal), rng)
    approach = contact_pose(chosen, question)[:3, 2]
    direction = "horizontal" if abs(approach[2]) > np.cos(np.pi / 4) else "vertical"
    return with_constraint(proposal, Direction(chosen.agent, chosen.object or "", direction))


@fault
def uneven_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """One of two agents that must stay level lifts higher than the other."""
    level = {agent for c in proposal.constraints if isinstance(c, SameHeight) for agent in c.agents}
    chosen = choose([s for s in proposal.subgoals if s.agent in level and s.height_m is not None], rng)
    return with_subgoal(proposal, chosen, replace(chosen, height_m=(chosen.height_m or 0.0) + UNEVEN_M))


# -- agents and objects
@fault
def wrong_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """Two agents have each other's subgoals; the constraints still speak of the right ones."""
    agents = list(dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals))
    if len(agents) < 2 or not any(demands_point(proposal, s) for s in contacts(proposal)):
        raise _NotApplicable
    first, second = (int(agent) for agent in rng.choice(agents, 2, replace=False))
    other = {first: second, second: first}
    swapped = tuple(replace(s, agent=other.get(s.agent, s.agent)) for s in proposal.subgoals)
    if set(swapped) == set(proposal.subgoals):
        raise _NotApplicable
    return replace(proposal, subgoals=swapped)


@fault
def unknown_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A constraint names an agent that does not exist."""
    return with_constraint(proposal, AvoidAgents((len(question.task.agents) + 1,)))


@fault
def missing_object(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A subgoal names an object that does not exist."""
    chosen = choose([s for s in proposal.subgoals if s.object], rng)
    return with_subgoal(proposal, chosen, replace(chosen, object=f"second_{chosen.object}"))


@fault
def missing_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An object is to be placed at a target that does not exist."""
    chosen = choose([s for s in proposal.subgoals if s.target], rng)
    return with_subgoal(proposal, chosen, replace(chosen, target="nowhere", target_point=None))


@partial(fault, breaks=False)
def missing_subgoal(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """The last subgoal of an agent is left out."""
    lasts = {subgoal.agent: subgoal for subgoal in proposal.subgoals}
    left_out = choose(list(lasts.values()), rng)
    if len(proposal.subgoals) < 2:
        raise _NotApplicable
    return replace(proposal, subgoals=tuple(s for s in proposal.subgoals if s is not left_out))


@partial(fault, breaks=False)
def missing_constraint(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """One constraint is left out."""
    left_out = choose(proposal.constraints, rng)
    rest = tuple(each for each in proposal.constraints if each is not left_out)
    return replace(proposal, constraints=rest)


@fault
def unreadable_constraint(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A constraint is worded so that it matches no check."""
    chosen = int(rng.choice(question.task.agents))
    text = f"{agent_name(chosen)} should mind its manners."
    return with_constraint(proposal, read_or_unparsed(text, question.task.vocabulary, "spatial", (chosen,)))


# -- order and time
@fault
def swapped_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """Two consecutive subgoals of one agent are in the wrong order."""
    pairs = [
        pair
        for agent in question.task.agents
        for pair in pairwise(proposal.subgoals_of(agent))
        if pair[0].verb == "grasp" and pair[1].object == pair[0].object
    ]
    pair = choose(pairs, rng)
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    return replace(proposal, subgoals=tuple(other.get(s, s) for s in proposal.subgoals))


@fault
def circular_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An order is demanded in both directions."""
    order = choose(list(demanded_orders(proposal)), rng)
    return with_constraint(proposal, Before(order[1], order[0]))


@fault
def lost_synchronisation(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """One of two agents that must act together has to wait for the other."""
    together = choose([c for c in proposal.constraints if isinstance(c, Together)], rng)
    late, other = (int(agent) for agent in rng.permutation(together.agents[:2]))
    return with_constraint(proposal, Before(Step(other), Step(late), WAIT_S))


@fault
def impossible_deadline(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent has to be done before it can have moved."""
    movers = [s.agent for s in proposal.subgoals if s.verb not in ("hold", "home")]
    if not movers:
        raise _NotApplicable
    return with_constraint(proposal, Deadline(Step(int(rng.choice(movers))), TOO_SOON_S))


# -- space
@fault
def through_arm(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent has to pass through another arm, which grasps an object there and then stays."""
    options = [
        (parked, mover.agent)
        for parked, mover in product(contacts(proposal), proposal.subgoals)
        if parked.verb == "grasp" and mover.agent != parked.agent
        if not (is_moved_before(proposal, parked) or is_moved_before(proposal, mover))
        if goal_distance_m(parked, mover, question) < IN_THE_WAY_M
    ]
    parked, mover = choose(options, rng)
    subgoals = (parked, *proposal.subgoals_of(mover))
    remaining = (c for c in proposal.constraints if set(c.agents) <= {parked.agent, mover})
    return Proposal(subgoals, tuple(c for c in remaining if c.kind != "temporal"))


@fault
def unreachable_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent has to lift an object higher than its arm reaches."""
    lifts = [s for s in proposal.subgoals if s.verb == "lift"]
    if lifts:
        lift = choose(lifts, rng)
        return with_subgoal(proposal, lift, replace(lift, height_m=TOO_HIGH_M))
    last = {s.agent: s for s in proposal.subgoals}
    grasp = choose([s for s in last.values() if s.verb == "grasp"], rng)
    lift = Subgoal(grasp.agent, "lift", grasp.object, height_m=TOO_HIGH_M)
    return replace(proposal, subgoals=(*proposal.subgoals, lift))


@fault
def forbidden_zone(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """A constraint forbids the space around the very point that an agent has to reach."""
    chosen = choose(contacts_in_place(proposal), rng)
    centre = contact_pose(chosen, question)[:3, 3]
    low, high = (np.round(centre + side, 3) + 0.0 for side in (-ZONE_HALF_M, ZONE_HALF_M))
    return with_constraint(proposal, KeepOut(chosen.agent, tuple(low.tolist()), tuple(high.tolist())))


# -- limits that cannot be kept
@fault
def impossible_distance(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """Two agents that work side by side have to keep their grippers farther apart than they can."""
    pairs = [
        (one.agent, other.agent)
        for one, other in product(contacts(proposal), contacts(proposal))
        if one.agent < other.agent and goal_distance_m(one, other, question) < FAR_M / 2
    ]
    return with_constraint(proposal, KeepApart(choose(pairs, rng), FAR_M))


@fault
def impossible_tilt(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An object that an agent places may not be tilted at all, which no such motion achieves."""
    # A lift alone does not admit it: straight up, the tilt may be exactly zero.
    chosen = choose([s for s in proposal.subgoals if s.verb == "place" and s.object], rng)
    return with_constraint(proposal, KeepLevel(chosen.object or "", 0.0, chosen.agent))


@fault
def impossible_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent has to keep its gripper below the very point that it has to reach."""
    chosen = choose(contacts_in_place(proposal), rng)
    height_m = float(contact_pose(chosen, question)[2, 3])
    return with_constraint(proposal, KeepHeight(chosen.agent, max(0.0, round(height_m - BELOW_M, 3))))


@fault
def impossible_speed(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal:
    """An agent has to move very slowly, and to be done soon."""
    chosen = choose(contacts_in_place(proposal), rng)
    slowly = with_constraint(proposal, SpeedLimit(chosen.agent, CRAWL_M_S))
    return with_constraint(slowly, Deadline(Step(chosen.agent), SOON_S))


# -- helpers
def choose(options: Sequence[T], rng: np.random.Generator) -> T:
    if not options:
        raise _NotApplicable
    return options[int(rng.integers(len(options)))]


def contacts(proposal: Proposal) -> list[Subgoal]:
    """Subgoals that meet an annotated point."""
    return [s for s in proposal.subgoals if VERBS[s.verb].is_contact and s.object and s.point]


def demanded_orders(proposal: Proposal) -> Iterator[tuple[Step, Step]]:
    """The demanded orders of subgoals: the first step, and the step that waits for it."""
    for each in proposal.constraints:
        if isinstance(each, Before) and isinstance(each.first, Step) and each.first.verb and each.then.verb:
            yield each.first, each.then


def is_moved_before(proposal: Proposal, contact: Subgoal) -> bool:
    """Whether a demanded order moves the object before the contact, which then takes place elsewhere."""
    waiting = Step(contact.agent, contact.verb, contact.object)
    orders = demanded_orders(proposal)
    return any(first.object == contact.object and then == waiting for first, then in orders)


def contacts_in_place(proposal: Proposal) -> list[Subgoal]:
    """Contacts with objects at their present poses."""
    return [each for each in contacts(proposal) if not is_moved_before(proposal, each)]


def goal_m(subgoal: Subgoal, question: Question) -> NDArray[np.float64] | None:
    """The goal position (3,) of a subgoal: its target, or else the point of its object."""
    poses = {**question.task.places(question.scene), **question.scene.poses}
    if subgoal.target in poses:
        return poses[subgoal.target][:3, 3]
    return contact_pose(subgoal, question)[:3, 3] if subgoal.object and subgoal.point else None


def contact_pose(contact: Subgoal, question: Question) -> Matrix:
    """world_from_tcp of a contact, with its object at the present pose."""
    name, point = contact.object or "", contact.point or ""
    return question.scene.poses[name] @ question.task.asset(name).points[point].object_from_tcp


def goal_distance_m(one: Subgoal, other: Subgoal, question: Question) -> float:
    """The horizontal distance between the goals of two subgoals; infinite where one has no goal."""
    a, b = goal_m(one, question), goal_m(other, question)
    return float("inf") if a is None or b is None else float(np.linalg.norm(a[:2] - b[:2]))


def demands_point(proposal: Proposal, subgoal: Subgoal) -> bool:
    """Whether a logical constraint demands the point of the subgoal from its agent."""
    return any(
        isinstance(c, ContactAt) and (c.agent, c.point) == (subgoal.agent, subgoal.point)
        for c in proposal.constraints
    )


def with_subgoal(proposal: Proposal, old: Subgoal, new: Subgoal) -> Proposal:
    return replace(proposal, subgoals=tuple(new if s is old else s for s in proposal.subgoals))


def with_constraint(proposal: Proposal, constraint: Statement) -> Proposal:
    return replace(proposal, constraints=(*proposal.constraints, constraint))
