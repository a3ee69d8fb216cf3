"""Legal answers for a scene: all subgoals and constraints that the parser accepts.

A brain draws from them (`RandomBrain`), and the schema of an answer can list them (`strict_answer`). Legal
does not mean reachable or useful: planner and checks decide that. Constraints that consist of a number
(distances, speeds, deadlines, zones) are not among them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product

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
    keep_clear,
)
from rf_exp.tasks import Task
from rf_exp.types import Scene, Subgoal

HEIGHTS_M = (0.05, 0.1, 0.15, 0.2)  # by which objects are lifted
PUTTING = ("place", "drop")  # kinds of points at which objects are put
TOGETHER = ("grasp", "lift")  # verbs that several arms can do at the same time with one object
OVER = ("lift", "place", "press", "shut", "strike")  # verbs after which another arm may go on


@dataclass(frozen=True)
class Legal:
    """Legal subgoals and constraints of one scene."""

    subgoals: Mapping[int, Sequence[Subgoal]]  # agent -> subgoals
    constraints: Sequence[Statement]

    def fitting(self, subgoals: Sequence[Subgoal]) -> list[Statement]:
        """The constraints that refer to nothing beyond these subgoals."""
        said = {Step(each.agent, each.verb, each.object) for each in subgoals}
        met = {(each.agent, each.object, each.point) for each in subgoals if VERBS[each.verb].is_contact}
        return [each for each in self.constraints if _fits(each, said, met)]


def legal(task: Task, scene: Scene) -> Legal:
    """The legal subgoals and constraints of a scene of a task."""
    subgoals = {agent: list(_subgoals(agent, task, scene)) for agent in task.agents}
    every = [each for agent in task.agents for each in subgoals[agent]]
    constraints = [*_logical(every), *_in_time(every, task.agents), *keep_clear(task.agents)]
    return Legal(subgoals, [*constraints, *map(AvoidAgents, combinations(task.agents, 2))])


def _subgoals(agent: int, task: Task, scene: Scene) -> Iterator[Subgoal]:
    """Subgoals with every verb: for objects at their points, or for objects that an arm can hold."""
    points = task.vocabulary.points
    met = [(name, point, kind) for name, known in points.items() for point, kind in known.items()]
    held = [(name, None) for name, known in points.items() if "grasp" in known.values()]
    places = [(name, None) for name in task.places(scene)]
    places += [(name, point) for name, point, kind in met if kind in PUTTING]
    for verb in VERBS.values():
        things = held if "object" in verb.needs else [(None, None)]
        if "point" in verb.needs:
            things = sorted((name, point) for name, point, kind in met if kind == verb.meets)
        targets = places if "target" in verb.needs else [(None, None)]
        heights = HEIGHTS_M if "height_m" in verb.needs else [None]
        for (name, point), (target, at), height_m in product(things, targets, heights):
            if target is None or target != name:
                yield Subgoal(agent, verb.name, name, point, target, at, height_m)


def _logical(subgoals: Sequence[Subgoal]) -> Iterator[Statement]:
    contacts = [each for each in subgoals if VERBS[each.verb].is_contact]
    yield from (ContactAt(each.agent, each.verb, each.object or "", each.point or "") for each in contacts)
    yield from dict.fromkeys(Direction(each.agent, each.object or "") for each in contacts)
    for pair in combinations(dict.fromkeys(each.agent for each in subgoals), 2):
        yield SameHeight(pair)


def _in_time(subgoals: Sequence[Subgoal], agents: Sequence[int]) -> Iterator[Statement]:
    steps = list(dict.fromkeys(Step(each.agent, each.verb, each.object) for each in subgoals if each.object))
    for pair in combinations(agents, 2):
        shared = (each for each in steps if each.agent == pair[0] and each.verb in TOGETHER)
        yield from (Together(pair, each.verb, each.object, 2.0) for each in shared)
        yield ShareSpace(pair)
    for first, then in permutations(steps, 2):
        if first.agent != then.agent and first.verb in OVER and then.verb in (*TOGETHER, *OVER):
            yield Before(first, then)


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
