"""Three Robots Stack Cube: three arms build a stack of three cubes on the goal, one cube each."""

from itertools import pairwise

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, every, height_m, near, on, released, set_down
from rf_exp.tasks.shared.placing import fetch, in_turn
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

STACK = {1: "blue", 2: "red", 3: "green"}  # agent -> its cube, from the bottom up


def plan(scene: Scene, task: Task) -> Proposal:
    """Everybody fetches a cube; each is placed once the one below it lies there."""
    subgoals: list[Subgoal] = []
    for (agent, name), stands in zip(STACK.items(), _standing(scene, task), strict=True):
        if subgoals or not stands or not released(scene, [name]):
            below = STACK.get(agent - 1)
            subgoals += fetch(agent, name, below or "goal", "top" if below else "middle")
    agents = sorted({subgoal.agent for subgoal in subgoals})
    constraints: list[Statement] = grasping(subgoals)
    for first, then in pairwise(agents):
        constraints += in_turn(Step(first, "place", STACK[first]), Step(then, "place", STACK[then]))
    return Proposal(tuple(subgoals), (*constraints, *keep_clear(task.agents)))


def _standing(scene: Scene, task: Task) -> list[Condition]:
    """Which of the cubes lies where it belongs: blue on the goal, the others on the one below."""
    limits = task.success
    down = below(height_m(scene, "blue"), limits["above_m"], "m")
    bottom = every((near(scene, "blue", "goal", limits["goal_m"]), down))
    upper = [on(scene, task, top, bearer, limits["beside_m"]) for bearer, top in pairwise(STACK.values())]
    return [bottom, *upper]


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each cube is in its place, level, let go and at rest."""
    standing = zip(STACK.values(), _standing(scene, task), strict=True)
    return {
        **{f"{name} in its place": there for name, there in standing},
        **set_down(scene, STACK.values(), task.success),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: each cube above the one below, the upper two near the goal."""
    limits = task.success
    over_goal = all(near(scene, name, "goal", limits["paper_goal_m"]) for name in ("red", "green"))
    high = all(
        on(scene, task, top, below, limits["paper_beside_m"]) for below, top in pairwise(STACK.values())
    )
    return over_goal and high and released(scene, STACK.values())
