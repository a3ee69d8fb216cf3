"""Predicted state of planning, collision queries, and the error for motions that do not exist."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Cause, Finding, FindingFacts, agent_name
from rf_exp.transforms import Matrix

Obstacle = int | str  # the number of an agent, or the name of an object
Floats = NDArray[np.float64]
Points = Floats  # (K, dof) rad


class Unreachable(Exception):
    """Raised where no motion carries out a subgoal.

    `agents`: the one that cannot, then those in its way. `facts`: further fields of `FindingFacts`.
    `blockage` is set where something is in the way.
    """

    def __init__(
        self,
        cause: Cause,
        finding: Finding,
        agents: tuple[int, ...],
        blockage: "Blockage | None" = None,
        **facts: Any,
    ) -> None:
        super().__init__(finding)
        self.cause, self.agents, self.blockage = cause, agents, blockage
        self.facts = {"finding": finding, **facts}

    def __str__(self) -> str:
        return FindingFacts(time_s=0.0, agents=self.agents, **self.facts).sentence


def obstacle_name(obstacle: Obstacle) -> str:
    return agent_name(obstacle) if isinstance(obstacle, int) else obstacle


@dataclass(frozen=True, eq=False)
class State:
    """Predicted state at one moment: joints, grippers, held objects, poses of objects."""

    qpos: Mapping[int, Floats]  # agent -> (dof,) rad
    gripper: Mapping[int, float]
    held: Mapping[int, tuple[str, Matrix]]  # agent -> object, tcp_from_object
    poses: Mapping[str, Matrix]  # object -> world_from_object
    places: Mapping[str, Matrix] = field(default_factory=dict)
    targets: frozenset[str] = frozenset()  # objects of the present subgoal

    def in_hand(self, agent: int) -> frozenset[str]:
        """The object that an agent holds, if any."""
        return frozenset({self.held[agent][0]} if agent in self.held else ())


@dataclass(frozen=True, eq=False)
class Blockage:
    """A motion and its obstacle; the distance between them is measured only for a refusal."""

    agent: int
    points: Points
    state: State
    touches: frozenset[str]
    obstacle: Obstacle
    where: str = ""  # part of the motion, where known


def obstruction_error(
    subgoal_text: str, *blockages: Blockage, finding: Finding = Finding.BLOCKED
) -> Unreachable:
    """The error for a subgoal that is blocked; the distance is measured for the first of the blockages."""
    first, obstacles = blockages[0], [blockage.obstacle for blockage in blockages]
    agents = first.agent, *(obstacle for obstacle in obstacles if isinstance(obstacle, int))
    facts = {"subgoals": (subgoal_text,), "obstacles": tuple(map(obstacle_name, obstacles))}
    return Unreachable(Cause.SPACE, finding, agents, first, **facts)


class Blocked(Protocol):
    """Collision test: what blocks an agent at joint points, and `between` them; None where they are free.

    The gripper may touch `touches`. With `gripper_only`, the gripper and its load alone are tested, against
    objects.
    """

    def __call__(
        self,
        agent: int,
        points: Points,
        state: State,
        touches: frozenset[str],
        *,
        between: bool = False,
        gripper_only: bool = False,
    ) -> Obstacle | None: ...
