"""What a planned motion must not run into, as far as the row of constraints lets the planner see."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.motion import Blockage, Blocked, Obstacle, State, name_of
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    OBJECT_MARGIN_M,
    PlanningScene,
    Swept,
    closer_than,
    folded,
    nearest,
)
from rf_exp.perception import SEEN, Seen
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet, Scene, fingers_of


class Obstacles:
    """The static world of a planner: objects, table and arms where the predicted state has them.

    Without spatial constraints the planner is blind to everything but what its subgoal is about and the
    table it is bolted to. Where the scene has been looked at by depth cameras, what they see is in the way.
    """

    def __init__(self, task: Task, scene: Scene, constraint_set: ConstraintSet, proposal: Proposal) -> None:
        self._task, self._scene, self._constraint_set, self._proposal = task, scene, constraint_set, proposal
        self._seen = Seen(PlanningScene(task, scene)) if scene.seen is not None else None

    def blocked(self, *, avoid_arms: bool) -> Blocked:
        """The test that motion primitives ask; `avoid_arms` counts arms that stand still as obstacles."""

        task = self._task

        def test(
            agent: int,
            points: NDArray[np.float64],
            state: State,
            touches: frozenset[str],
            *,
            between: bool = False,
        ) -> Obstacle | None:
            planning_scene = self._planning_scene(state)
            body = self._body(planning_scene, agent, points, state, touches)
            if folded(body, task.arms[agent].robot.self_pairs).any():
                return "the arm itself"
            hit = planning_scene.below_table(body)
            for obstacles, other, margin_m in self._others(planning_scene, agent, state, touches, avoid_arms):
                if closer_than(body, other, margin_m, between=between).any():
                    each = ((one, _only(other, one)) for one in obstacles[:-1])
                    near = (one for one, it in each if closer_than(body, it, margin_m, between=between).any())
                    return next(near, obstacles[-1])
            return "the table" if hit.any() else None

        return test

    def how_near(self, blockage: Blockage) -> dict[str, Any]:
        """Which parts come how near to one another, and how near they may, as facts of a `Found`.

        Nothing where the arm itself or the table is in the way.
        """
        state, touches = blockage.state, blockage.touches
        planning_scene = self._planning_scene(state)
        body = self._body(planning_scene, blockage.agent, blockage.points, state, touches)
        obstacle = blockage.obstacle
        for obstacles, other, margin_m in self._others(planning_scene, blockage.agent, state, touches, True):
            if obstacle in obstacles and (gap := nearest(body, _only(other, obstacle))) is not None:
                near = {"value": gap.distance_m, "bound": margin_m, "unit": "m"}
                other_part = f"{gap.b} of {name_of(obstacle)}" if isinstance(obstacle, int) else gap.b
                return {**near, "parts": (gap.a, other_part), "aspect": blockage.where}
        return {}

    def _planning_scene(self, state: State) -> PlanningScene:
        qpos = self._scene.qpos.copy()
        for agent, joints in state.qpos.items():
            qpos[agent - 1, : len(joints)] = joints
            fingers_of(qpos)[agent - 1] = self._task.arms[agent].robot.hand.open_m
        held = tuple(state.held[agent][0] if agent in state.held else None for agent in self._task.agents)
        return PlanningScene(self._task, replace(self._scene, qpos=qpos, poses=dict(state.poses), held=held))

    def _body(
        self,
        planning_scene: PlanningScene,
        agent: int,
        points: NDArray[np.float64],
        state: State,
        touches: frozenset[str],
    ) -> Swept:
        attached, tcp_from_object = state.held.get(agent, (None, None))
        return planning_scene.arm(
            agent, points, attached=attached, tcp_from_object=tcp_from_object, touches=touches
        )

    def _others(
        self,
        planning_scene: PlanningScene,
        agent: int,
        state: State,
        touches: frozenset[str],
        avoid_arms: bool,
    ) -> Iterator[tuple[Sequence[Obstacle], Swept, float]]:
        """What is in the way, and how near one may come; things together, as most often none is near."""
        attached = state.held[agent][0] if agent in state.held else None
        everything = (*self._task.objects, *self._task.clutter)
        names: Collection[str] = everything if self._constraint_set.spatial else sorted(state.targets)
        if self._seen is not None and self._constraint_set.spatial:
            boxes, exactly = self._seen.obstacles(agent, self._minds_not(agent, state) | touches)
            names = sorted(exactly)
            yield [SEEN], boxes, OBJECT_MARGIN_M
        if others := [name for name in names if name != attached]:
            yield others, planning_scene.standing(others), OBJECT_MARGIN_M
        for other in self._task.agents if avoid_arms and self._constraint_set.spatial else ():
            if other != agent:
                yield [other], planning_scene.measured(other), AGENT_MARGIN_M

    def _minds_not(self, agent: int, state: State) -> frozenset[str]:
        """What the agent's subgoals are about, what is held, and what has moved since the cameras looked."""
        about = {name for subgoal in self._proposal.of(agent) for name in subgoal.names}
        held = {name for name, _ in state.held.values()}
        poses = self._scene.poses
        moved = {name for name, pose in state.poses.items() if not np.array_equal(pose, poses[name])}
        return frozenset((about | held | moved | state.targets) & set(self._task.objects))


def _only(body: Swept, obstacle: Obstacle) -> Swept:
    """One of the things that a body is made of; all of an arm."""
    return body if isinstance(obstacle, int) else body.only(obstacle)
