"""Look-ahead of the shield: where and when the paths of agents meet that do what they are about to do."""

from collections.abc import Collection, Mapping
from math import inf

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, Swept, closer_than, nearest
from rf_exp.tasks import FINGERS_OPEN_M, Task
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS, Scene

TRAILS_STEPS = 2  # a measured arm trails its commands by 0.1 s: damping over stiffness of its drives
LOOKAHEAD_STEPS = 10  # a violation that is farther off is no reason to wait yet
CLOSER_M = 1e-4  # arms that lack the margin already may not come closer than they are by more than this
Commands = NDArray[np.float64]  # (T, 8) rad, gripper command
Pair = tuple[int, int]  # agents i < j


class Lookahead:
    """The paths of all agents, from where they were sent last to the end of the commands ahead of them.

    The path of an agent: where it stands (twice, so that its first position is one of standing still), its
    commands ahead, and its end once more. Its load goes with its hand, also behind a command that opens it:
    until then it holds them.
    """

    def __init__(
        self, task: Task, scene: Scene, given: NDArray[np.float64], ahead: Mapping[int, Commands]
    ) -> None:
        self.ahead = ahead
        self._task, self._scene, self._given = task, scene, given
        self._planning_scene = PlanningScene(task, scene)
        self._swept: dict[int, Swept] = {}
        self._diagrams: dict[Pair, NDArray[np.bool_]] = {}

    def held(self, agent: int) -> str | None:
        return self._scene.held[agent - 1]

    def holding_with(self, agent: int) -> list[int]:
        """An agent, and those that hold the same thing."""
        load = self.held(agent)
        return [
            each
            for each in self._task.agents
            if each == agent or (load is not None and load == self.held(each))
        ]

    def meet(self, pair: Pair, waits: Collection[int] = ()) -> float:
        """The first control step from now after which two are closer than the margin; inf without one.

        Who waits stands still.
        """
        diagram = self.diagram(pair)
        steps = np.arange(1, max(map(len, map(self.ahead.__getitem__, pair))) + TRAILS_STEPS + 1)
        hit = np.zeros(len(steps), dtype=bool)
        for late in range(TRAILS_STEPS + 1):
            for behind in ((late, 0), (0, late)):
                at = [
                    self._at(agent, steps - by, agent in waits)
                    for agent, by in zip(pair, behind, strict=True)
                ]
                hit |= diagram[at[0], at[1]]
        return float(steps[hit.argmax()]) if hit.any() else inf

    def enters(self, pair: Pair) -> dict[int, int]:
        """Agent -> the first position on its path that the other one's path comes too close to."""
        diagram = self.diagram(pair)
        return {agent: int(diagram.any(axis=axis).argmax()) for agent, axis in zip(pair, (1, 0), strict=True)}

    def room_to_slow_down(self, agent: int, waits: Collection[int]) -> bool:
        """Whether the whole next step of an agent is clear of all others, whatever they do soon."""
        for other in self._task.agents:
            if other == agent:
                continue
            pair = (min(agent, other), max(agent, other))
            diagram = self.diagram(pair) if agent < other else self.diagram(pair).T
            end = 3 if other in waits else LOOKAHEAD_STEPS + 2
            if diagram[1:3, :end].any():
                return False
        return True

    def diagram(self, pair: Pair) -> NDArray[np.bool_]:
        """(P, Q) which positions on the paths of two are closer than the margin."""
        if pair not in self._diagrams:
            a, b = map(self._body, pair)
            now_m = _apart_m(a, b, 0, 0)
            if now_m >= AGENT_MARGIN_M:
                found = closer_than(a, b, AGENT_MARGIN_M)
            else:  # who lacks the margin already may go apart
                found = np.zeros((len(a), len(b)), dtype=bool)
                for row, column in ((0, 2), (2, 0), (2, 2)):
                    closer = _apart_m(a, b, row, column) < now_m - CLOSER_M
                    found[_from(row), _from(column)] = closer
            self._diagrams[pair] = found
        return self._diagrams[pair]

    def _at(self, agent: int, steps: NDArray[np.int64], waits: bool) -> NDArray[np.int64]:
        """Positions on the path of an agent after control steps."""
        return np.zeros_like(steps) if waits else np.clip(steps, 0, len(self.ahead[agent]) + 1) + 1

    def _body(self, agent: int) -> Swept:
        if agent not in self._swept:
            row = agent - 1
            given, ahead = self._given[row], self.ahead[agent]
            path = np.concatenate([[given, given], ahead, ahead[-1:]])
            measured = self._scene.qpos[row]
            # never narrower than it is now: fingers may need longer than this to close
            wide = (path[:, ARM_JOINTS:] + 1.0) / 2.0 * FINGERS_OPEN_M
            fingers = np.maximum.accumulate(np.maximum(wide, measured[ARM_JOINTS:].max()), axis=0)
            qpos = np.hstack([path[:, :ARM_JOINTS], fingers, fingers])
            load = self.held(agent)
            grip = None
            if load is not None:
                grip = inverse(self._planning_scene.arms[row].tcp(measured)) @ self._scene.poses[load]
            self._swept[agent] = self._planning_scene.arm(
                agent, qpos, attached=load, tcp_from_object=grip, touches=self._task.objects
            )
        return self._swept[agent]


def _apart_m(a: Swept, b: Swept, row: int, column: int) -> float:
    found = nearest(a, b, np.array([[row, column]]))
    assert found is not None  # links must always keep apart
    return found.distance_m


def _from(position: int) -> slice:
    """The positions of going on, or those of standing still."""
    return slice(position, None) if position else slice(0, 2)
