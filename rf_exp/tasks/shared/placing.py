"""Pick-and-place of objects, and its order between arms."""

from rf_exp.statements import Before, ShareSpace, Statement, Step
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import every, on_goal, released, set_down
from rf_exp.types import Condition, Scene, Subgoal


def pick_and_place(
    agent: int, thing: str, target: str, target_point: str | None = None, grip: str = "center"
) -> list[Subgoal]:
    """Subgoals to grasp an object at a point and place it."""
    place = Subgoal(agent, "place", thing, target=target, target_point=target_point)
    return [Subgoal(agent, "grasp", thing, grip), place]


def in_turn(first: Step, second: Step) -> list[Statement]:
    """One step comes before another, and their agents yield to each other."""
    return [Before(first, second), ShareSpace((first.agent, second.agent))]


def goals(task: Task) -> dict[str, str]:
    """Cube -> the goal with its number."""
    return {name: name.replace("cube", "goal") for name in task.objects if name.startswith("cube")}


def undelivered_cubes(scene: Scene, task: Task) -> dict[str, str]:
    """Cube -> its goal, for the cubes that are not there yet or are still held."""
    return {
        cube: goal
        for cube, goal in goals(task).items()
        if not on_goal(scene, cube, goal, task.success) or not released(scene, [cube])
    }


def delivered_conditions(scene: Scene, task: Task, condition_name: str) -> dict[str, Condition]:
    """Conditions that each cube is on its goal (named `condition_name`), upright, released and at rest."""
    pairs = goals(task)
    on_goals = every(on_goal(scene, cube, goal, task.success) for cube, goal in pairs.items())
    return {condition_name: on_goals, **set_down(scene, pairs, task.success)}
