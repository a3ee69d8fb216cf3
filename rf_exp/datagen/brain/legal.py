"""What may be said in a scene: subgoals and constraints that are read without a complaint, all of them.

A brain draws from them (`random.py`), and the schema of an answer can list them (`strict_answer`). They
are legal and no more: whether an arm reaches a thing, and whether it is any use, is for planner and checks
to say. Constraints that are made of a number (distances, speeds, deadlines, zones) are not among them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product
from typing import Any

from rf_exp.statements import (
    VERBS,
    AvoidAgents,
    Before,
    ContactAt,
    Direction,
    SameHeight,
    ShareSpace,
    Statement,
    Step,
    Together,
    Verb,
    keep_clear,
)
from rf_exp.tasks import Task
from rf_exp.types import Scene, Subgoal

HEIGHTS_M = (0.05, 0.1, 0.15, 0.2)  # by which things are lifted
PUTTING = ("place", "drop")  # kinds of points at which things are put
TOGETHER = ("grasp", "lift")  # verbs that several arms can do at the same time with one thing
OVER = ("lift", "place", "press", "shut", "strike")  # verbs after which another arm may go on


@dataclass(frozen=True)
class Legal:
    """What may be said of one scene."""

    subgoals: Mapping[int, Sequence[Subgoal]]  # of each agent
    constraints: Sequence[Statement]

    def fitting(self, subgoals: Sequence[Subgoal]) -> list[Statement]:
        """The constraints that speak of nothing but what these subgoals are about."""
        said = {Step(each.agent, each.verb, each.object) for each in subgoals}
        met = {(each.agent, each.object, each.point) for each in subgoals if VERBS[each.verb].is_contact}
        return [each for each in self.constraints if _fits(each, said, met)]


def legal(task: Task, scene: Scene) -> Legal:
    """What may be said of a scene of a task."""
    subgoals = {agent: list(_subgoals(agent, task, scene)) for agent in task.agents}
    every = [each for agent in task.agents for each in subgoals[agent]]
    return Legal(subgoals, [*_logical(every), *_in_time(every, task.agents), *_apart(task.agents)])


def _subgoals(agent: int, task: Task, scene: Scene) -> Iterator[Subgoal]:
    points = task.vocabulary.points
    held = [name for name, known in points.items() if "grasp" in known.values()]
    places = [(name, None) for name in task.places(scene)]
    places += [(name, point) for name, known in points.items() for point in known if known[point] in PUTTING]
    for verb in VERBS.values():
        for parts in _parts(verb, points, held, places):
            yield Subgoal(agent, verb.name, **parts)


def _parts(
    verb: Verb,
    points: Mapping[str, Mapping[str, str]],
    held: Sequence[str],
    places: Sequence[tuple[str, str | None]],
) -> Iterator[dict[str, Any]]:
    """The parts of every subgoal with a verb: things at their points, or those that an arm can hold."""
    things: list[dict[str, Any]] = [{"object": name} for name in held] if "object" in verb.needs else [{}]
    if "point" in verb.needs:
        met = product(points, {point for known in points.values() for point in known})
        things = [
            {"object": name, "point": point}
            for name, point in sorted(met)
            if points[name].get(point) == verb.meets
        ]
    targets = places if "target" in verb.needs else [(None, None)]
    heights = HEIGHTS_M if "height_m" in verb.needs else [None]
    for thing, (target, point), height_m in product(things, targets, heights):
        if target is None or target != thing.get("object"):
            yield {**thing, "target": target, "target_point": point, "height_m": height_m}


def _logical(subgoals: Sequence[Subgoal]) -> Iterator[Statement]:
    contacts = [each for each in subgoals if VERBS[each.verb].is_contact]
    yield from (ContactAt(each.agent, each.verb, each.object or "", each.point or "") for each in contacts)
    yield from dict.fromkeys(Direction(each.agent, each.object or "") for each in contacts)
    for pair in combinations(dict.fromkeys(each.agent for each in subgoals), 2):
        yield SameHeight(pair)


def _in_time(subgoals: Sequence[Subgoal], agents: Sequence[int]) -> Iterator[Statement]:
    steps = list(dict.fromkeys(Step(each.agent, each.verb, each.object) for each in subgoals if each.object))
    for pair in combinations(agents, 2):
        yield from (
            Together(pair, each.verb, each.object, 2.0)
            for each in steps
            if each.agent == pair[0] and each.verb in TOGETHER
        )
        yield ShareSpace(pair)
    for first, then in permutations(steps, 2):
        if first.agent != then.agent and first.verb in OVER and then.verb in (*TOGETHER, *OVER):
            yield Before(first, then)


def _apart(agents: Sequence[int]) -> Iterator[Statement]:
    yield from keep_clear(agents)
    yield from map(AvoidAgents, combinations(agents, 2))


def _fits(stated: Statement, said: set[Step], met: set[tuple[int, str | None, str | None]]) -> bool:
    match stated:
        case ContactAt():
            return (stated.agent, stated.object, stated.point) in met
        case Direction():
            return any((stated.agent, stated.object) == each[:2] for each in met)
        case Together():
            return {Step(agent, stated.verb, stated.object) for agent in stated.who} <= said
        case Before():
            return {stated.first, stated.then} <= said
        case SameHeight():
            lifted = {each.agent: each.object for each in said if each.verb == "lift"}
            return {*stated.who} <= lifted.keys() and len({lifted[agent] for agent in stated.who}) == 1
    return {*stated.agents} <= {each.agent for each in said}
