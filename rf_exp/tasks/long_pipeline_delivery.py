"""Long Pipeline Delivery: a shoe goes through the hands of four arms to the goal."""

from itertools import pairwise

from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.shared import shoe_on_goal
from rf_exp.tasks.shared.relay import deliver, remaining
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Scene

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
    subgoals, constraints = deliver("shoe", remaining(scene, task, "shoe", CHAIN), "goal")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


conditions, paper = shoe_on_goal.conditions, shoe_on_goal.paper
