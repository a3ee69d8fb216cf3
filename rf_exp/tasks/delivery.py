"""A shoe on its way to a goal: shared by Pass Shoe and Long Pipeline Delivery.

The task's objects are `shoe` and `goal`, a mark on the table.
"""

from rf_exp.tasks.base import Task
from rf_exp.tasks.measure import height_m, near, released, set_down
from rf_exp.types import Scene


def arrived(scene: Scene, task: Task) -> bool:
    """Whether the shoe stands on the goal."""
    down = height_m(scene, "shoe") < task.success["down_m"]
    return down and near(scene, "shoe", "goal", task.success["goal_m"])


def done(scene: Scene, task: Task) -> bool:
    """Whether nothing is left to do: the shoe is on the goal and nobody holds it."""
    return arrived(scene, task) and released(scene, ["shoe"])


def conditions(scene: Scene, task: Task) -> dict[str, bool]:
    """The shoe stands upright on the goal, let go and at rest."""
    return {"shoe on the goal": arrived(scene, task), **set_down(scene, ["shoe"], task.success)}


def paper(scene: Scene, task: Task) -> bool:
    """The release's criterion: the shoe is near the goal, seen from above."""
    return near(scene, "shoe", "goal", task.success["paper_distance_m"])
