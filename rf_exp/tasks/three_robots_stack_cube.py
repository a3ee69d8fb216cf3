"""Three Robots Stack Cube: three arms build a stack of three cubes on the goal, one cube each."""

from itertools import pairwise

from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import near, on, released
from rf_exp.tasks.shared import stacking
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"

STACK = {"blue": 1, "red": 2, "green": 3}  # cube -> agent, from the bottom up


def plan(scene: Scene, task: Task) -> Proposal:
    """All arms fetch their cubes; each is placed once the one below it is in place."""
    return stacking.plan(scene, task, STACK)


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each cube is in its place, level, released and at rest."""
    return stacking.conditions(scene, task, [*STACK])


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: each cube above the one below, the upper two near the goal, none held."""
    limits = task.success
    steps = [*pairwise(STACK)]
    over_goal = all(near(scene, top, "goal", limits["paper_goal_m"]) for _, top in steps)
    high = all(on(scene, task, top, below, limits["paper_beside_m"]) for below, top in steps)
    return over_goal and high and released(scene, STACK)
