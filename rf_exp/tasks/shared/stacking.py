"""A stack of cubes on a goal, built by several arms: for tasks that stack cubes and the family *tower*.

A stack maps cubes to agents, from the bottom up; the task has an object `goal`.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import on, on_goal, released, set_down
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.types import Condition, Scene, Subgoal


def plan(scene: Scene, task: Task, stack: Mapping[str, int]) -> Proposal:
    """All arms fetch their cubes; each is placed once the one below it is in place."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    remaining: list[tuple[int, str]] = []
    target = "goal", "middle"
    for (name, agent), in_place in zip(stack.items(), cubes_in_place(scene, task, [*stack]), strict=True):
        if remaining or not in_place or not released(scene, [name]):
            remaining.append((agent, name))
            subgoals += pick_and_place(agent, name, *target)
        target = name, "top"
    for (agent_below, lower), (agent_above, upper) in pairwise(remaining):
        if agent_below != agent_above:
            constraints += in_turn(Step(agent_below, "place", lower), Step(agent_above, "place", upper))
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


def cubes_in_place(scene: Scene, task: Task, names: Sequence[str]) -> list[Condition]:
    """Whether each cube is in place: the first on the goal, the others on the one below."""
    limits = task.success
    bottom = on_goal(scene, names[0], "goal", limits)
    return [bottom, *(on(scene, task, top, bearer, limits["beside_m"]) for bearer, top in pairwise(names))]


def conditions(scene: Scene, task: Task, names: Sequence[str]) -> dict[str, Condition]:
    """Each cube is in its place, level, released and at rest."""
    in_place = zip(names, cubes_in_place(scene, task, names), strict=True)
    places = {f"{name} in its place": condition for name, condition in in_place}
    return {**places, **set_down(scene, names, task.success)}


def conditions_of_two(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Blue on the goal, red on blue, both level, released and at rest."""
    on_the_goal, on_blue = cubes_in_place(scene, task, ("blue", "red"))
    places = {"blue on the goal": on_the_goal, "red on blue": on_blue}
    return {**places, **set_down(scene, ("blue", "red"), task.success)}
