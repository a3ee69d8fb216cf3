"""Two Robots Stack Cube: one arm brings the blue cube to the goal, the other puts the red one on it."""

from rf_exp.statements import Proposal, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders, near, on, released
from rf_exp.tasks.shared import stacking
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

BASE, TOP = 1, 2  # agents
CUBES = ("blue", "red")


def plan(scene: Scene, task: Task) -> Proposal:
    """Both arms fetch their cubes; the red one is placed once the blue one lies on the goal."""
    subgoals: list[Subgoal] = []
    on_the_goal, on_blue = stacking.cubes_in_place(scene, task, CUBES)
    if not on_the_goal or holders(scene, "blue"):
        subgoals += pick_and_place(BASE, "blue", "goal", "middle")
    if subgoals or not on_blue or holders(scene, "red"):
        subgoals += pick_and_place(TOP, "red", "blue", "top")
    both = {subgoal.agent for subgoal in subgoals} == {BASE, TOP}
    order = in_turn(Step(BASE, "place", "blue"), Step(TOP, "place", "red")) if both else []
    return Proposal(tuple(subgoals), (*grasping(subgoals), *order, *keep_clear(task.agents)))


conditions = stacking.conditions_of_two


def paper(scene: Scene, start: Scene, task: Task) -> Condition:
    """The release's criterion: red above blue, blue near the goal, neither cube held."""
    near_goal = near(scene, "blue", "goal", task.success["paper_goal_m"])
    above = on(scene, task, "red", "blue", task.success["paper_beside_m"])
    return near_goal and above and released(scene, CUBES)
