"""Mistakes that a proposal can hold, by name. Each takes a sound proposal and puts one mistake in."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain.protocol import Question
from rf_exp.errors import choices
from rf_exp.statements import (
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
    understood,
)
from rf_exp.transforms import Matrix
from rf_exp.types import Subgoal

T = TypeVar("T")
Change = Callable[[Proposal, Question, np.random.Generator], Proposal | None]

ZONE_HALF_M = 0.1
TOO_HIGH_M = 3.0
UNEVEN_M = 0.06
TOO_SOON_S = 0.1
APART_S = 5.0
IN_THE_WAY_M = 0.1
FAR_M = 1.6
UNDER_M = 0.02
CRAWLS_M_S, SOON_S = 0.02, 2.0  # 4 cm


@dataclass(frozen=True)
class Fault:
    """A named mistake."""

    name: str
    change: Change  # None from it: does not apply here
    breaks: bool  # True: something that was demanded cannot hold; False: a demand is left out

    @property
    def description(self) -> str:
        return " ".join((self.change.__doc__ or "").split())


FAULTS: dict[str, Fault] = {}


def _fault(*, breaks: bool) -> Callable[[Change], Change]:
    def register(change: Change) -> Change:
        name = change.__name__.lstrip("_")  # pyright: ignore[reportFunctionMemberAccess]
        FAULTS[name] = Fault(name, change, breaks)
        return change

    return register


def fault_named(fault: str) -> Fault:
    """The fault of that name. Raises ArgumentError that lists them."""
    if fault not in FAULTS:
        raise choices("fault", fault, FAULTS)
    return FAULTS[fault]


# -- logical -----------------------------------------------------------------------------------------


@_fault(breaks=True)
def _wrong_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent grasps an object at another of its points than the constraint demands."""
    options = [
        replace(subgoal, point=other)
        for subgoal in _contacts(proposal)
        if _demands_point(proposal, subgoal)
        for other in _points(question, subgoal)
        if other != subgoal.point
    ]
    wrong = _any(options, rng)
    return wrong and replace(
        proposal,
        subgoals=tuple(
            wrong if (s.agent, s.verb, s.object) == (wrong.agent, wrong.verb, wrong.object) else s
            for s in proposal.subgoals
        ),
    )


@_fault(breaks=True)
def _unknown_point(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A subgoal names an interaction point that its object does not have."""
    chosen = _any(_contacts(proposal), rng)
    return chosen and _exchanged(proposal, chosen, replace(chosen, point="nowhere"))


@_fault(breaks=True)
def _wrong_direction(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint demands another direction of approach than the annotated one."""
    chosen = _any(_contacts(proposal), rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    approach = _contact_point(chosen.object, chosen.point, question)[:3, 2]
    direction = "horizontal" if abs(approach[2]) > np.cos(np.pi / 4) else "vertical"
    return _with(proposal, Direction(chosen.agent, chosen.object, direction))


@_fault(breaks=True)
def _uneven_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """One of two agents that must stay level lifts higher than the other."""
    level = {agent for c in proposal.constraints if isinstance(c, SameHeight) for agent in c.agents}
    chosen = _any([s for s in proposal.subgoals if s.agent in level and s.height_m is not None], rng)
    if chosen is None or chosen.height_m is None:
        return None
    return _exchanged(proposal, chosen, replace(chosen, height_m=chosen.height_m + UNEVEN_M))


# -- who and what ------------------------------------------------------------------------------------


@_fault(breaks=True)
def _wrong_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two agents have each other's subgoals; the constraints still speak of the right ones."""
    agents = list(dict.fromkeys(subgoal.agent for subgoal in proposal.subgoals))
    if len(agents) < 2 or not any(_demands_point(proposal, s) for s in _contacts(proposal)):
        return None
    first, second = (int(agent) for agent in rng.choice(agents, 2, replace=False))
    other = {first: second, second: first}
    swapped = tuple(replace(s, agent=other.get(s.agent, s.agent)) for s in proposal.subgoals)
    return None if set(swapped) == set(proposal.subgoals) else replace(proposal, subgoals=swapped)


@_fault(breaks=True)
def _unknown_agent(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint speaks of an agent that is not there."""
    return _with(proposal, AvoidAgents((len(question.task.agents) + 1,)))


@_fault(breaks=True)
def _missing_object(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A subgoal is about an object that is not there."""
    chosen = _any([s for s in proposal.subgoals if s.object], rng)
    return chosen and _exchanged(proposal, chosen, replace(chosen, object=f"second_{chosen.object}"))


@_fault(breaks=True)
def _missing_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Something is to be put at a place that is not there."""
    chosen = _any([s for s in proposal.subgoals if s.target], rng)
    return chosen and _exchanged(proposal, chosen, replace(chosen, target="nowhere", target_point=None))


@_fault(breaks=False)
def _missing_subgoal(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """The last subgoal of an agent is left out."""
    lasts = {subgoal.agent: subgoal for subgoal in proposal.subgoals}
    left_out = _any(list(lasts.values()), rng)
    if left_out is None or len(proposal.subgoals) < 2:
        return None
    return replace(proposal, subgoals=tuple(s for s in proposal.subgoals if s is not left_out))


@_fault(breaks=False)
def _missing_constraint(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """One constraint is left out."""
    left_out = _any(list(proposal.constraints), rng)
    return left_out and replace(
        proposal, constraints=tuple(c for c in proposal.constraints if c is not left_out)
    )


@_fault(breaks=True)
def _unreadable_constraint(
    proposal: Proposal, question: Question, rng: np.random.Generator
) -> Proposal | None:
    """A constraint is stated in words that no check stands for."""
    chosen = int(rng.choice(question.task.agents))
    text = f"{agent_name(chosen)} should mind its manners."
    return _with(proposal, understood(text, question.task.vocabulary, "spatial", (chosen,)))


# -- temporal ----------------------------------------------------------------------------------------


@_fault(breaks=True)
def _swapped_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two consecutive subgoals of one agent are in the wrong order."""
    pairs = [
        pair
        for agent in question.task.agents
        for pair in zip(proposal.of(agent), proposal.of(agent)[1:], strict=False)
        if pair[0].verb == "grasp" and pair[1].object == pair[0].object
    ]
    pair = _any(pairs, rng)
    if pair is None:
        return None
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    return replace(proposal, subgoals=tuple(other.get(s, s) for s in proposal.subgoals))


@_fault(breaks=True)
def _circular_order(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An order is demanded both ways round."""
    order = _any(list(_orders(proposal)), rng)
    if order is None:
        return None
    first, then = order
    return _with(proposal, Before(then, first))


@_fault(breaks=True)
def _lost_synchronisation(
    proposal: Proposal, question: Question, rng: np.random.Generator
) -> Proposal | None:
    """One of two agents that must act together is told to wait for the other."""
    together = _any([c for c in proposal.constraints if isinstance(c, Together)], rng)
    if together is None:
        return None
    late, other = (int(agent) for agent in rng.permutation(together.agents[:2]))
    return _with(proposal, Before(Step(other), Step(late), APART_S))


@_fault(breaks=True)
def _impossible_deadline(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to be finished before it can have moved."""
    movers = [s.agent for s in proposal.subgoals if s.verb not in ("hold", "home")]
    if not movers:
        return None
    chosen = int(rng.choice(movers))
    return _with(proposal, Deadline(Step(chosen), TOO_SOON_S))


# -- spatial -----------------------------------------------------------------------------------------


@_fault(breaks=True)
def _through_arm(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent has to go through another arm, which grasps something there and is told no more."""
    options = [
        (parked, goes.agent)
        for parked in _contacts(proposal)
        for goes in proposal.subgoals
        if parked.verb == "grasp" and goes.agent != parked.agent
        if not (_is_brought(proposal, parked) or _is_brought(proposal, goes))
        if _apart_m(_where(parked, question), _where(goes, question)) < IN_THE_WAY_M
    ]
    option = _any(options, rng)
    if option is None:
        return None
    parked, goes = option
    subgoals = (parked, *proposal.of(goes))
    orders = tuple(c for c in proposal.constraints if c.kind != "temporal")
    return Proposal(subgoals, tuple(c for c in orders if set(c.agents) <= {parked.agent, goes}))


@_fault(breaks=True)
def _unreachable_target(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to lift something higher than its arm reaches."""
    lifts = [s for s in proposal.subgoals if s.verb == "lift"]
    if (lift := _any(lifts, rng)) is not None:
        return _exchanged(proposal, lift, replace(lift, height_m=TOO_HIGH_M))
    last = {s.agent: s for s in proposal.subgoals}
    grasp = _any([s for s in last.values() if s.verb == "grasp"], rng)
    if grasp is None:
        return None
    lift = Subgoal(grasp.agent, "lift", grasp.object, height_m=TOO_HIGH_M)
    return replace(proposal, subgoals=(*proposal.subgoals, lift))


@_fault(breaks=True)
def _forbidden_zone(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """A constraint forbids the space around the very point that an agent is to reach."""
    chosen = _any([s for s in _contacts(proposal) if not _is_brought(proposal, s)], rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    centre = _contact_point(chosen.object, chosen.point, question)[:3, 3]
    low, high = (np.round(centre + side, 3) + 0.0 for side in (-ZONE_HALF_M, ZONE_HALF_M))
    return _with(proposal, KeepOut(chosen.agent, tuple(low.tolist()), tuple(high.tolist())))


# -- limits ------------------------------------------------------------------------------------------


@_fault(breaks=True)
def _impossible_distance(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """Two agents that work side by side are to keep their grippers farther apart than they can."""
    pairs = [
        (one.agent, other.agent)
        for one in _contacts(proposal)
        for other in _contacts(proposal)
        if one.agent < other.agent and _apart_m(_where(one, question), _where(other, question)) < FAR_M / 2
    ]
    pair = _any(pairs, rng)
    return pair and _with(proposal, KeepApart(pair, FAR_M))


@_fault(breaks=True)
def _impossible_tilt(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """What an agent puts somewhere may not be tilted at all, not even by what no such motion is without."""
    # A lift alone is no room for it: straight up, the tilt may be exactly none.
    chosen = _any([s for s in proposal.subgoals if s.verb == "place" and s.object], rng)
    return chosen and _with(proposal, KeepLevel(chosen.object or "", 0.0, chosen.agent))


@_fault(breaks=True)
def _impossible_height(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to keep its gripper below the very point that it is to reach."""
    chosen = _any([s for s in _contacts(proposal) if not _is_brought(proposal, s)], rng)
    if chosen is None or chosen.object is None or chosen.point is None:
        return None
    height_m = float(_contact_point(chosen.object, chosen.point, question)[2, 3])
    return _with(proposal, KeepHeight(chosen.agent, max(0.0, round(height_m - UNDER_M, 3))))


@_fault(breaks=True)
def _impossible_speed(proposal: Proposal, question: Question, rng: np.random.Generator) -> Proposal | None:
    """An agent is to move very slowly, and to be done soon."""
    chosen = _any([s for s in _contacts(proposal) if not _is_brought(proposal, s)], rng)
    if chosen is None:
        return None
    slowly = _with(proposal, SpeedLimit(chosen.agent, CRAWLS_M_S))
    return _with(slowly, Deadline(Step(chosen.agent), SOON_S))


# -- what the faults are made of ---------------------------------------------------------------------


def _any(options: list[T], rng: np.random.Generator) -> T | None:
    return options[int(rng.integers(len(options)))] if options else None


def _contacts(proposal: Proposal) -> list[Subgoal]:
    """Subgoals that meet an annotated point."""
    return [s for s in proposal.subgoals if s.verb in ("grasp", "press") and s.object and s.point]


def _orders(proposal: Proposal) -> Iterator[tuple[Step, Step]]:
    """The orders of subgoals that are demanded: what comes first, and what waits for it."""
    for each in proposal.constraints:
        if isinstance(each, Before) and isinstance(each.first, Step) and each.first.verb and each.then.verb:
            yield each.first, each.then


def _is_brought(proposal: Proposal, contact: Subgoal) -> bool:
    """Whether another agent moves the object before the contact, so that it is met at another place."""
    meets = Step(contact.agent, contact.verb, contact.object)
    return any(first.object == contact.object and then == meets for first, then in _orders(proposal))


def _where(subgoal: Subgoal, question: Question) -> NDArray[np.float64] | None:
    """Where a subgoal leads (3,): its target, or else the point of its object."""
    poses = {**question.task.places(question.scene), **question.scene.poses}
    if subgoal.target in poses:
        return poses[subgoal.target][:3, 3]
    if subgoal.object is None or subgoal.point is None:
        return None
    return _contact_point(subgoal.object, subgoal.point, question)[:3, 3]


def _contact_point(name: str, point: str, question: Question) -> Matrix:
    """world_from_tcp of an annotated point as its object stands now."""
    return question.scene.poses[name] @ question.task.asset(name).points[point].object_from_tcp


def _apart_m(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> float:
    """The distance of two positions on the level; infinite where there is none."""
    return float("inf") if a is None or b is None else float(np.linalg.norm(a[:2] - b[:2]))


def _points(question: Question, subgoal: Subgoal) -> list[str]:
    """The points of the subgoal's object that serve its verb."""
    points = question.task.asset(subgoal.object or "").points
    return [name for name, point in points.items() if point.kind == subgoal.verb]


def _demands_point(proposal: Proposal, subgoal: Subgoal) -> bool:
    """Whether a logical constraint demands the point of the subgoal from its agent."""
    return any(
        isinstance(c, ContactAt) and (c.agent, c.point) == (subgoal.agent, subgoal.point)
        for c in proposal.constraints
    )


def _exchanged(proposal: Proposal, old: Subgoal, new: Subgoal) -> Proposal:
    return replace(proposal, subgoals=tuple(new if s is old else s for s in proposal.subgoals))


def _with(proposal: Proposal, constraint: Statement) -> Proposal:
    return replace(proposal, constraints=(*proposal.constraints, constraint))
