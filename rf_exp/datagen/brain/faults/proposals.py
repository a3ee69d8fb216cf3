"""What faults are made of: what a proposal says, where it leads, and a proposal that is changed."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import Before, ContactAt, Proposal, Statement, Step
from rf_exp.transforms import Matrix
from rf_exp.types import Subgoal

T = TypeVar("T")


def choose(options: list[T], rng: np.random.Generator) -> T | None:
    return options[int(rng.integers(len(options)))] if options else None


def contacts(proposal: Proposal) -> list[Subgoal]:
    """Subgoals that meet an annotated point."""
    return [s for s in proposal.subgoals if s.verb in ("grasp", "press") and s.object and s.point]


def orders(proposal: Proposal) -> Iterator[tuple[Step, Step]]:
    """The orders of subgoals that are demanded: what comes first, and what waits for it."""
    for each in proposal.constraints:
        if isinstance(each, Before) and isinstance(each.first, Step) and each.first.verb and each.then.verb:
            yield each.first, each.then


def is_brought(proposal: Proposal, contact: Subgoal) -> bool:
    """Whether another agent moves the object before the contact, so that it is met at another place."""
    meets = Step(contact.agent, contact.verb, contact.object)
    return any(first.object == contact.object and then == meets for first, then in orders(proposal))


def goal_m(subgoal: Subgoal, question: Question) -> NDArray[np.float64] | None:
    """Where a subgoal leads (3,): its target, or else the point of its object."""
    poses = {**question.task.places(question.scene), **question.scene.poses}
    if subgoal.target in poses:
        return poses[subgoal.target][:3, 3]
    if subgoal.object is None or subgoal.point is None:
        return None
    return contact_pose(subgoal.object, subgoal.point, question)[:3, 3]


def contact_pose(name: str, point: str, question: Question) -> Matrix:
    """world_from_tcp of an annotated point as its object stands now."""
    return question.scene.poses[name] @ question.task.asset(name).points[point].object_from_tcp


def apart_m(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> float:
    """The distance of two positions on the level; infinite where there is none."""
    return float("inf") if a is None or b is None else float(np.linalg.norm(a[:2] - b[:2]))


def points_of(question: Question, subgoal: Subgoal) -> list[str]:
    """The points of the subgoal's object that serve its verb."""
    points = question.task.asset(subgoal.object or "").points
    return [name for name, point in points.items() if point.kind == subgoal.verb]


def demands_point(proposal: Proposal, subgoal: Subgoal) -> bool:
    """Whether a logical constraint demands the point of the subgoal from its agent."""
    return any(
        isinstance(c, ContactAt) and (c.agent, c.point) == (subgoal.agent, subgoal.point)
        for c in proposal.constraints
    )


def exchanged(proposal: Proposal, old: Subgoal, new: Subgoal) -> Proposal:
    return replace(proposal, subgoals=tuple(new if s is old else s for s in proposal.subgoals))


def with_constraint(proposal: Proposal, constraint: Statement) -> Proposal:
    return replace(proposal, constraints=(*proposal.constraints, constraint))
