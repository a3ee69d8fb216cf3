"""Strike Cube Hard: one arm brings the cube to the goal, the other strikes it there with the hammer."""

from rf_exp.statements import Proposal, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import near, on_goal, released, set_down
from rf_exp.tasks.shared import striking
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

SMITH, HELPER = 1, 2  # agents: the first strikes, the second brings the cube


def plan(scene: Scene, task: Task) -> Proposal:
    """Grasp the hammer while the cube is fetched; strike once the cube lies on the goal."""
    subgoals: list[Subgoal] = []
    brought = on_goal(scene, "cube", "goal", task.success) and released(scene, ["cube"])
    if brought and striking.struck(scene, task, SMITH):
        return Proposal((), ())
    if not brought:
        subgoals += pick_and_place(HELPER, "cube", "goal", "middle")
    subgoals += striking.take_and_strike(scene, SMITH)
    order = [] if brought else in_turn(Step(HELPER, "place", "cube"), Step(SMITH, "strike", "hammer"))
    return Proposal(tuple(subgoals), (*grasping(subgoals), *order, *keep_clear(task.agents)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The cube lies on the goal, released and at rest; the held hammer rests on it with its face down."""
    return {
        **striking.conditions(scene, task, SMITH),
        "cube on the goal": on_goal(scene, "cube", "goal", task.success),
        **set_down(scene, ["cube"], task.success),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the hammer's head is near the top of the cube, and the cube near the goal."""
    struck = striking.paper(scene, start, task)
    return struck and bool(near(scene, "cube", "goal", task.success["paper_goal_m"]))
