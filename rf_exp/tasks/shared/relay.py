"""Relay: several arms pass an object on. For Long Pipeline Delivery and the family *chain*.

At the task's place `stop<k>` agent k puts objects down for the next agent of the chain.
"""

from collections.abc import Sequence
from itertools import pairwise

from rf_exp.statements import Statement, Step
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders, near
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.types import Scene, Subgoal


def deliver(name: str, chain: Sequence[int], goal: str) -> tuple[list[Subgoal], list[Statement]]:
    """Each arm puts it down within reach of the next one and yields; the last one puts it on `goal`."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    for agent in chain:
        subgoals += pick_and_place(agent, name, goal if agent == chain[-1] else f"stop{agent}")
    for giver, taker in pairwise(chain):
        constraints += in_turn(Step(giver, "place", name), Step(taker, "grasp", name))
    return subgoals, constraints


def remaining(scene: Scene, task: Task, name: str, chain: Sequence[int]) -> Sequence[int]:
    """The rest of the chain, from the agent that holds the object, finds it at a stop, or is nearest."""
    places, within_m = task.places(scene), task.success["goal_m"]
    takers = (
        taker for giver, taker in pairwise(chain) if near(scene, name, places[f"stop{giver}"], within_m)
    )
    nearest = min(chain, key=lambda agent: abs(task.robots[agent - 1].y_m - scene.poses[name][1, 3]))
    return chain[chain.index(next(iter(holders(scene, name) or takers), nearest)) :]
