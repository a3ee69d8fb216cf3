"""Lift: arms in a circle grasp one frame from all sides and lift it level."""

from typing import Any

from rf_exp.statements import Proposal, SameHeight, Together, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders, raised, risen_m
from rf_exp.tasks.shared import circle
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

LIFT_M = 0.17  # lift of all grippers: slightly more than the required rise
NEARER_M = 0.2  # shift of the frame towards a single arm, which grasps it in its middle
TOGETHER_S = 2.0  # at most, between the first gripper that closes and the last


def layout(
    arms: int, things: int, *, radius_m: float, jitter_m: float, jitter_deg: float, step_limit: int
) -> dict[str, Any]:
    """A frame with one grasp point per arm, at the centre of the circle."""
    y_m = 0.0 if arms > 1 else -NEARER_M
    ranges = {
        "x_m": [-jitter_m, jitter_m],
        "y_m": [y_m - jitter_m, y_m + jitter_m],
        "yaw_deg": [-jitter_deg, jitter_deg],
    }
    frame = {"asset": "frame", "options": {"grips": arms}, **ranges}
    return {
        **circle.robots_and_cameras(arms, radius_m),
        "objects": {"frame": frame},
        "step_limit": step_limit,
    }


def plan(scene: Scene, task: Task) -> Proposal:
    """All arms grasp the frame; once all hold it, they lift it at the same time."""
    held, agents = holders(scene, "frame"), task.agents
    if held == agents:
        lifts = tuple(Subgoal(agent, "lift", "frame", height_m=LIFT_M) for agent in agents)
        level = (SameHeight(agents), Together(agents, "lift", "frame")) if len(agents) > 1 else ()
        return Proposal(lifts, (*level, *keep_clear(agents)))
    grasps = tuple(Subgoal(agent, "grasp", "frame", f"grip{agent}") for agent in agents)
    together = (Together(agents, "grasp", "frame", TOGETHER_S),) if len(agents) > 1 else ()
    return Proposal(grasps, (*grasping(grasps), *together, *keep_clear(agents)))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """All arms hold the frame, which is lifted, level and at rest."""
    held = holders(scene, "frame") == task.agents
    return {"held by all arms": held, **raised(scene, start, "frame", task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """As for Lift Barrier: the centre has risen by more than the threshold."""
    return risen_m(scene, start, "frame") > task.success["lift_m"]
