"""What planning believes while it looks ahead, and how it asks about obstacles."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.transforms import Matrix
from rf_exp.types import Cause

Obstacle = int | str  # the number of an agent, or the name of a thing


class Unreachable(Exception):
    """No motion carries out a subgoal; the text says why.

    `agents`: the one that cannot, then those that are in its way.
    """

    def __init__(self, cause: Cause, agents: tuple[int, ...], text: str) -> None:
        super().__init__(text)
        self.cause: Cause = cause
        self.agents = agents


def in_the_way(obstacle: Obstacle) -> str:
    """In words."""
    return f"{f'Agent_{obstacle}' if isinstance(obstacle, int) else obstacle} is in the way"


@dataclass
class State:
    """What planning believes so far: joints, grippers, what is held, where things are."""

    qpos: dict[int, NDArray[np.float64]]  # agent -> (7,) rad
    gripper: dict[int, float]
    held: dict[int, tuple[str, Matrix]]  # agent -> object, tcp_from_object
    poses: dict[str, Matrix]  # object -> world_from_object
    places: Mapping[str, Matrix] = field(default_factory=dict)
    targets: frozenset[str] = frozenset()  # objects that the present subgoal is about


class Blocked(Protocol):
    """Knows the obstacles: who or what is in the way of an agent at joint points (K, 7), or None.

    The gripper may touch `touches`. With `between`, the motion from each point to the next counts too.
    """

    def __call__(
        self,
        agent: int,
        points: NDArray[np.float64],
        state: State,
        touches: frozenset[str],
        *,
        between: bool = False,
    ) -> Obstacle | None: ...
