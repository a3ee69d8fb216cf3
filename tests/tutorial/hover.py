"""Custom verb `hover`: the gripper moves above an object, pointing down, and touches nothing."""

import numpy as np

from rf_exp.datagen import Motion, Request, State, add_primitive
from rf_exp.statements import Verb, add_verb
from rf_exp.transforms import from_axes

OVER_M = 0.25  # height of the tool centre point above the origin of the object


def hover(request: Request, state: State) -> Motion:
    """One motion to a pose above the object, with any of four yaw angles of the gripper."""
    subgoal = request.subgoal
    assert subgoal.object is not None  # the form of the verb requires it
    over = state.poses[subgoal.object][:3, 3] + np.array([0.0, 0.0, OVER_M])
    goals = [from_axes(over, z=(0, 0, -1), y=y) for y in ((0, 1, 0), (1, 0, 0), (0, -1, 0), (-1, 0, 0))]
    points = request.reach.timed(request.agent, [goals], 0.0, state, frozenset(), subgoal.text)
    hovering, state = request.segment("hover", points, state)
    return (hovering,), state


add_verb(Verb("hover", ("object",), words=("hover hovers hovered hovered hovering",)))
add_primitive("hover", hover)
