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
PLACING_KINDS = ("place", "drop")  # kinds of points at which objects are put
JOINT_VERBS = ("grasp", "lift")  # verbs that several arms can do at the same time with one object
ORDERED_VERBS = ("lift", "place", "press", "shut", "strike")  # verbs after which another arm may go on


@dataclass(frozen=True)
class LegalAnswers:
    """Legal subgoals and constraints of one scene."""

    subgoals: Mapping[int, Sequence[Subgoal]]  # agent -> subgoals
    constraints: Sequence[Statement]

    def fitting(self, subgoals: Sequence[Subgoal]) -> list[Statement]:
        """The constraints that refer to nothing beyond these subgoals."""
        steps = {Step(subgoal.agent, subgoal.verb, subgoal.object) for subgoal in subgoals}
        contacting = [subgoal for subgoal in subgoals if VERBS[subgoal.verb].is_contact]
        contacts = {(subgoal.agent, subgoal.object, subgoal.point) for subgoal in contacting}
        return [constraint for constraint in self.constraints if _fits(constraint, steps, contacts)]


def legal_answers(task: Task, scene: Scene) -> LegalAnswers:
    """The legal subgoals and constraints of a scene of a task."""
    subgoals = {agent: list(_subgoals(agent, task, scene)) for agent in task.agents}
    all_subgoals = [subgoal for agent in task.agents for subgoal in subgoals[agent]]
    constraints = [*_logical(all_subgoals), *_temporal(all_subgoals, task.agents), *keep_clear(task.agents)]
    return LegalAnswers(subgoals, [*constraints, *map(AvoidAgents, combinations(task.agents, 2))])


def _subgoals(agent: int, task: Task, scene: Scene) -> Iterator[Subgoal]:
    """Subgoals with every verb: for objects at their points, or for objects that an arm can hold."""
    points = task.vocabulary.points
    object_points = [(name, point, kind) for name, kinds in points.items() for point, kind in kinds.items()]
    graspable = [(name, None) for name, kinds in points.items() if "grasp" in kinds.values()]
    places = [(name, None) for name in task.places(scene)]
    places += [(name, point) for name, point, kind in object_points if kind in PLACING_KINDS]
    for verb in VERBS.values():
        objects = graspable if "object" in verb.needs else [(None, None)]
        if "point" in verb.needs:
            objects = sorted((name, point) for name, point, kind in object_points if kind == verb.meets)
        targets = places if "target" in verb.needs else [(None, None)]
        heights = HEIGHTS_M if "height_m" in verb.needs else [None]
        for (name, point), (target, target_point), height_m in product(objects, targets, heights):
            if target is None or target != name:
                yield Subgoal(agent, verb.name, name, point, target, target_point, height_m)


def _logical(subgoals: Sequence[Subgoal]) -> Iterator[Statement]:
    contacts = [subgoal for subgoal in subgoals if VERBS[subgoal.verb].is_contact]
    yield from (ContactAt(each.agent, each.verb, each.object or "", each.point or "") for each in contacts)
    yield from dict.fromkeys(Direction(subgoal.agent, subgoal.object or "") for subgoal in contacts)
    for pair in combinations(dict.fromkeys(subgoal.agent for subgoal in subgoals), 2):
        yield SameHeight(pair)


def _temporal(subgoals: Sequence[Subgoal], agents: Sequence[int]) -> Iterator[Statement]:
    steps = list(dict.fromkeys(Step(each.agent, each.verb, each.object) for each in subgoals if each.object))
    for pair in combinations(agents, 2):
        joint_steps = (step for step in steps if step.agent == pair[0] and step.verb in JOINT_VERBS)
        yield from (Together(pair, step.verb, step.object, 2.0) for step in joint_steps)
        yield ShareSpace(pair)
    for first, then in permutations(steps, 2):
        ordered = first.verb in ORDERED_VERBS and then.verb in (*JOINT_VERBS, *ORDERED_VERBS)
        if first.agent != then.agent and ordered:
            yield Before(first, then)


def _fits(statement: Statement, steps: set[Step], contacts: set[tuple[int, str | None, str | None]]) -> bool:
    match statement:
        case ContactAt():
            return (statement.agent, statement.object, statement.point) in contacts
        case Direction():
            return any((statement.agent, statement.object) == contact[:2] for contact in contacts)
        case Together():
            return {Step(agent, statement.verb, statement.object) for agent in statement.who} <= steps
        case Before():
            return {statement.first, statement.then} <= steps
        case SameHeight():
            lifted = {step.agent: step.object for step in steps if step.verb == "lift"}
            return {*statement.who} <= lifted.keys() and len({lifted[agent] for agent in statement.who}) == 1
    return {*statement.agents} <= {step.agent for step in steps}
