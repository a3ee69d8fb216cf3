"""Two Robots Stack Cube: one arm brings the blue cube to the goal, the other puts the red one on it."""

from rf_exp.statements import Proposal, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders, near, on, on_goal, released, set_down
from rf_exp.tasks.shared.placing import fetch, in_turn
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

BASE, TOP = 1, 2  # the agents
CUBES = ("blue", "red")


def plan(scene: Scene, task: Task) -> Proposal:
    """Both fetch their cubes; the red one comes down once the blue one lies on the goal."""
    subgoals: list[Subgoal] = []
    if not _on_goal(scene, task) or holders(scene, "blue"):
        subgoals += fetch(BASE, "blue", "goal", "middle")
    if subgoals or not _on_blue(scene, task) or holders(scene, "red"):
        subgoals += fetch(TOP, "red", "blue", "top")
    both = {subgoal.agent for subgoal in subgoals} == {BASE, TOP}
    order = in_turn(Step(BASE, "place", "blue"), Step(TOP, "place", "red")) if both else []
    return Proposal(tuple(subgoals), (*grasping(subgoals), *order, *keep_clear(task.agents)))


def _on_goal(scene: Scene, task: Task) -> Condition:
    return on_goal(scene, "blue", "goal", task.success)


def _on_blue(scene: Scene, task: Task) -> Condition:
    return on(scene, task, "red", "blue", task.success["beside_m"])


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Blue on the goal, red on blue, both level, let go and at rest."""
    return {
        "blue on the goal": _on_goal(scene, task),
        "red on blue": _on_blue(scene, task),
        **set_down(scene, CUBES, task.success),
    }


def paper(scene: Scene, start: Scene, task: Task) -> Condition:
    """The release's criterion: red above blue, blue near the goal, nothing grasped."""
    limits = task.success
    on_goal = near(scene, "blue", "goal", limits["paper_goal_m"])
    above = on(scene, task, "red", "blue", limits["paper_beside_m"])
    return on_goal and above and released(scene, CUBES)
