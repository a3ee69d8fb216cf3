"""Long Pipeline Delivery: a shoe goes through the hands of four arms to the goal."""

from itertools import pairwise

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import distance_xy_m, holders
from rf_exp.tasks.shared import shoe_on_goal
from rf_exp.tasks.shared.placing import fetch, in_turn
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

CHAIN = (4, 3, 2, 1)  # agents from the shoe to the goal
STOP_X_M = -0.35  # of the places between two neighbours


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """Half-way between neighbours: `stop4` is where agent 4 lays the shoe for agent 3."""
    bases = {agent: task.robots[agent - 1] for agent in CHAIN}
    return {
        f"stop{giver}": planar(STOP_X_M, (bases[giver].y_m + bases[taker].y_m) / 2, 0.0)
        for giver, taker in pairwise(CHAIN)
    }


def plan(scene: Scene, task: Task) -> Proposal:
    """From where the shoe is now: each arm lays it within reach of the next one and yields."""
    if shoe_on_goal.done(scene, task):
        return Proposal((), ())
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    chain = CHAIN[CHAIN.index(_turn(scene, task)) :]
    for agent in chain:
        subgoals += fetch(agent, "shoe", "goal" if agent == chain[-1] else f"stop{agent}")
    for giver, taker in pairwise(chain):
        constraints += in_turn(Step(giver, "place", "shoe"), Step(taker, "grasp", "shoe"))
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


def _turn(scene: Scene, task: Task) -> int:
    """Whose turn it is: who holds the shoe, who finds it at a stop, or who is nearest to it."""
    if holders(scene, "shoe"):
        return holders(scene, "shoe")[0]
    for giver, taker in pairwise(CHAIN):
        if distance_xy_m(scene.poses["shoe"], task.places(scene)[f"stop{giver}"]) < task.success["goal_m"]:
            return taker
    return min(CHAIN, key=lambda agent: abs(task.robots[agent - 1].y_m - scene.poses["shoe"][1, 3]))


conditions, paper = shoe_on_goal.conditions, shoe_on_goal.paper
