"""What lies where in the rows that tell of an arm: its joints first, its hand last.

A row of measured joints (..., D) ends with the two fingers in m, a row of a command (..., D - 1) with the
gripper, from -1 closed to 1 open. What lies before is of the arm, in rad. Robots with fewer joints than
another one of their task have zeros behind their own.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FINGERS = 2  # of a hand

Number = TypeVar("Number", bound=np.generic)


def joints_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., D - 2) of the arm, of measured joints (..., D)."""
    return qpos[..., :-FINGERS]


def fingers_of(qpos: NDArray[Number]) -> NDArray[Number]:
    """(..., 2) m from the middle, of measured joints (..., D)."""
    return qpos[..., -FINGERS:]


def arm_of(action: NDArray[Number]) -> NDArray[Number]:
    """(..., A - 1) joint targets of the arm, of commands (..., A)."""
    return action[..., :-1]


def gripper_of(action: NDArray[Number]) -> NDArray[Number]:
    """(...) from -1 closed to 1 open, of commands (..., A)."""
    return action[..., -1]
