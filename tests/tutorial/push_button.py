"""Push Button: one arm presses a button from above."""

import numpy as np

from rf_exp.statements import AvoidObjects, ContactAt, Direction, Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import pushed_n
from rf_exp.types import Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

ARM = 1
DOWN = np.array([0.0, 0.0, -1.0])


def plan(scene: Scene, task: Task) -> Proposal:
    """Press the button; nothing more once it is pressed."""
    if _pushed(scene, task):
        return Proposal((), ())
    return Proposal(
        (Subgoal(ARM, "press", "button", "cap"),),
        (ContactAt(ARM, "press", "button", "cap"), Direction(ARM, "button"), AvoidObjects(ARM)),
    )


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, bool]:
    """The arm pushes the button hard enough."""
    return {"pushed": _pushed(scene, task)}


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The task is not in the paper: our criterion, without the steps for which it must hold."""
    return _pushed(scene, task)


def _pushed(scene: Scene, task: Task) -> bool:
    return pushed_n(scene, ARM, "button", DOWN) > task.success["push_n"]
