"""Success of bringing a shoe to a goal: shared by Pass Shoe and Long Pipeline Delivery.

The task's objects are `shoe` and `goal`, a mark on the table.
"""

from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, every, height_m, near, released, set_down
from rf_exp.types import Condition, Scene


def arrived(scene: Scene, task: Task) -> Condition:
    """Whether the shoe stands on the goal."""
    down = below(height_m(scene, "shoe"), task.success["down_m"], "m")
    return every((near(scene, "shoe", "goal", task.success["goal_m"]), down))


def done(scene: Scene, task: Task) -> bool:
    """Whether the plan is finished: the shoe is on the goal and released."""
    return bool(arrived(scene, task)) and released(scene, ["shoe"])


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The shoe stands upright on the goal, released and at rest."""
    return {"shoe on the goal": arrived(scene, task), **set_down(scene, ["shoe"], task.success)}


def paper(scene: Scene, start: Scene, task: Task) -> Condition:
    """The release's criterion: the shoe is near the goal, seen from above."""
    return near(scene, "shoe", "goal", task.success["paper_distance_m"])
