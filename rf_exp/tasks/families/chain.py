"""Chain: arms on alternating sides of a strip pass objects on to their goals."""

from itertools import pairwise
from typing import Any

from rf_exp.statements import Before, Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.shared import circle
from rf_exp.tasks.shared.circle import Numbers
from rf_exp.tasks.shared.placing import delivered_conditions, undelivered_cubes
from rf_exp.tasks.shared.relay import deliver, remaining
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"


def layout(
    arms: int,
    things: int,
    *,
    across_m: float,
    along_m: float,
    start_m: Numbers,
    goal_m: Numbers,
    step_limit: Numbers,
) -> dict[str, Any]:
    """Bases on alternating sides of the strip x = 0, objects at the first arm, goals at the last."""
    sides = [(-1) ** arm for arm in range(1, arms + 1)]
    along = [(arm - (arms + 1) / 2) * along_m for arm in range(1, arms + 1)]
    rest = {"rest_rad": circle.REST_RAD}
    robots = [
        {"x_m": sign * across_m, "y_m": y_m, "yaw_deg": 0.0 if sign < 0 else 180.0, **rest}
        for sign, y_m in zip(sides, along, strict=True)
    ]
    objects: dict[str, Any] = {}
    for k in range(things):
        y_m = along[-1] + k * goal_m["apart"]
        x_m = sides[-1] * (across_m - goal_m["forward"])
        objects[f"goal{k + 1}"] = circle.goal_at(x_m, y_m, goal_m["radius"])
    for k in range(things):
        x_m, y_m = sides[0] * (across_m - start_m["forward"]), along[0] - k * start_m["apart"]
        objects[f"cube{k + 1}"] = circle.cube_at(x_m, y_m, start_m["jitter"], k)
    # A longer row needs a more distant and wider view.
    eye_m, fov_deg = [0.4, 0.0, 1.3 + 0.12 * arms], 38.0 + 2.0 * arms
    cameras: dict[str, Any] = {"global": {"eye_m": eye_m, "target_m": [0.0, 0.0, 0.1], "fov_deg": fov_deg}}
    for agent, (sign, y_m) in enumerate(zip(sides, along, strict=True), start=1):
        eye_m, target_m = [-0.42 * sign, y_m, 0.68], [0.2 * sign, y_m, 0.1]
        cameras[f"agent{agent}"] = {"eye_m": eye_m, "target_m": target_m, "fov_deg": 66.0}
    limit = step_limit["first"] + arms * step_limit["each_arm"] + things * step_limit["each_thing"]
    return {"robots": robots, "objects": objects, "cameras": cameras, "step_limit": limit}


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """Transfer places on the strip, half-way between neighbours: from agent 1 to agent 2 at `stop1`."""
    return {
        f"stop{giver}": planar(0.0, (task.robots[giver - 1].y_m + task.robots[giver].y_m) / 2, 0.0)
        for giver in task.agents[:-1]
    }


def plan(scene: Scene, task: Task) -> Proposal:
    """Pass on each object from its present place; a stop takes the next one once the last one has left it."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    remaining_goals = undelivered_cubes(scene, task)
    chains = {cube: remaining(scene, task, cube, task.agents) for cube in remaining_goals}
    for cube, goal in remaining_goals.items():
        steps, delivery_constraints = deliver(cube, chains[cube], goal)
        subgoals, constraints = subgoals + steps, constraints + delivery_constraints
    for first, then in pairwise(remaining_goals):
        for giver, taker in pairwise(chains[then]):
            if taker in chains[first]:
                constraints.append(Before(Step(taker, "grasp", first), Step(giver, "place", then)))
    if not subgoals:
        return Proposal((), ())
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each object is on its goal, upright, released and at rest."""
    return delivered_conditions(scene, task, "things on their goals")
