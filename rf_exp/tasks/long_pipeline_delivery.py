"""Long Pipeline Delivery: four arms pass a shoe on to the goal."""

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
STOP_X_M = -0.35  # x of the transfer places


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """Transfer places half-way between neighbours: at `stop4` agent 4 puts the shoe down for agent 3."""
    bases = {agent: task.robots[agent - 1] for agent in CHAIN}
    return {
        f"stop{giver}": planar(STOP_X_M, (bases[giver].y_m + bases[taker].y_m) / 2, 0.0)
        for giver, taker in pairwise(CHAIN)
    }


def plan(scene: Scene, task: Task) -> Proposal:
    """The rest of the chain: each arm puts the shoe down within reach of the next one and yields."""
    if shoe_on_goal.done(scene, task):
        return Proposal((), ())
    subgoals, constraints = deliver("shoe", remaining(scene, task, "shoe", CHAIN), "goal")
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


conditions, paper = shoe_on_goal.conditions, shoe_on_goal.paper
