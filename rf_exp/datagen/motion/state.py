"""What planning believes while it looks ahead, and how it asks about obstacles."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Cause, Finding, Found, agent_name
from rf_exp.transforms import Matrix

Obstacle = int | str  # the number of an agent, or the name of a thing
Floats = NDArray[np.float64]
Points = Floats  # (K, dof) rad


class Unreachable(Exception):
    """No motion carries out a subgoal.

    `agents`: the one that cannot, then those that are in its way. `facts` are those of `Found` beside them;
    `blockage` is where something is in the way.
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
        return Found(time_s=0.0, agents=self.agents, **self.facts).sentence


def name_of(obstacle: Obstacle) -> str:
    return agent_name(obstacle) if isinstance(obstacle, int) else obstacle


@dataclass(frozen=True, eq=False)
class State:
    """What planning believes at one moment: joints, grippers, what is held, where things are."""

    qpos: Mapping[int, Floats]  # agent -> (dof,) rad
    gripper: Mapping[int, float]
    held: Mapping[int, tuple[str, Matrix]]  # agent -> object, tcp_from_object
    poses: Mapping[str, Matrix]  # object -> world_from_object
    places: Mapping[str, Matrix] = field(default_factory=dict)
    targets: frozenset[str] = frozenset()  # objects that the present subgoal is about

    def in_hand(self, agent: int) -> frozenset[str]:
        """What an agent holds, if anything."""
        return frozenset({self.held[agent][0]} if agent in self.held else ())


@dataclass(frozen=True, eq=False)
class Blockage:
    """A motion and what blocks it: enough to measure by how much, which only a refusal has to say."""

    agent: int
    points: Points
    state: State
    touches: frozenset[str]
    obstacle: Obstacle
    where: str = ""  # on the way, where that is known


def obstructed(what: str, *blockages: Blockage, finding: Finding = Finding.BLOCKED) -> Unreachable:
    """That a subgoal cannot be carried out for what is in the way; measured is the first of the blockages."""
    first, obstacles = blockages[0], [each.obstacle for each in blockages]
    agents = first.agent, *(each for each in obstacles if isinstance(each, int))
    facts = {"subgoals": (what,), "obstacles": tuple(map(name_of, obstacles))}
    return Unreachable(Cause.SPACE, finding, agents, first, **facts)


class Blocked(Protocol):
    """Who or what blocks an agent at joint points, and `between` them; its gripper may touch `touches`.

    Of the `hand` alone, with what it holds, only things are found.
    """

    def __call__(
        self,
        agent: int,
        points: Points,
        state: State,
        touches: frozenset[str],
        *,
        between: bool = False,
        hand: bool = False,
    ) -> Obstacle | None: ...
