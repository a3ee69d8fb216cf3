"""Incremental overlap test of measured arms over successive scenes.

For each pair of arms, lower bounds on the distance of every two pieces are kept from the last exact test,
and the motion of the pieces since then is subtracted. While all bounds are positive, the pair cannot overlap.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from rf_exp.geometry.clearance import SLACK_M, Nearest, exact_m, must_keep_apart, overlap
from rf_exp.geometry.planning_scene import PlanningScene
from rf_exp.geometry.swept import Swept, arm_pieces, asset_pieces
from rf_exp.tasks import Task
from rf_exp.transforms import transform_by_poses
from rf_exp.types import Scene

NEAR_M = 0.1  # pieces with bounding spheres closer than this are measured exactly

Load = str | None
Touches = Callable[[int], frozenset[str]]  # agent -> objects that its gripper and its load may touch
NO_LOADS: tuple[Load, ...] = (None, None)
NO_CONTACTS = (frozenset[str](), frozenset[str]())


@dataclass(frozen=True)
class _ExactTest:
    """Result of the last exact test of a pair of arms."""

    loads: tuple[Load, ...]
    allowed: tuple[frozenset[str], ...]  # allowed contacts of each arm
    bounds_m: NDArray[np.float64]  # (La, Lb), see `_bounds_m`
    until_m: float  # total travel of both arms below which all bounds stay positive
    moved_m: tuple[NDArray[np.float64], NDArray[np.float64]]  # (La,), (Lb,) total travel of pieces by then


def blocking_loads(scene: Scene, pair: tuple[int, int]) -> tuple[Load, ...]:
    """Objects held by two arms that are obstacles to the other arm; an object held by both is none."""
    held = scene.held[pair[0] - 1], scene.held[pair[1] - 1]
    return held if held[0] != held[1] else NO_LOADS


def allowed_contacts(
    pair: tuple[int, int], loads: tuple[Load, ...], touches: Touches
) -> tuple[frozenset[str], ...]:
    """Allowed contacts of two arms; empty for arms without loads, as links must always keep apart."""
    return NO_CONTACTS if loads == NO_LOADS else (touches(pair[0]), touches(pair[1]))


def measured_pair(
    planning_scene: PlanningScene, pair: tuple[int, int], touches: Touches
) -> tuple[Swept, Swept]:
    """Two measured arms, each with its load."""
    loads = blocking_loads(planning_scene.scene, pair)
    first, second = (
        planning_scene.measured(agent, attached=load, touches=allowed)
        for agent, load, allowed in zip(pair, loads, allowed_contacts(pair, loads, touches), strict=True)
    )
    return first, second


class Separation:
    """Incremental `overlap` of two measured arms over successive scenes, at a fraction of its cost.

    Scenes may come in any order; it is fast when successive scenes differ little.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._current: PlanningScene | None = None
        self._last_tests: dict[tuple[int, int], _ExactTest] = {}
        arms = [np.stack([piece.corners for piece in arm_pieces(arm.robot)]) for arm in task.arms.values()]
        self._names = [name for name in task.objects if asset_pieces(task.asset(name))]
        boxes = [trimesh.bounds.corners(task.asset(name).bounds_m) for name in self._names]
        # (B, 8, 3) bounding-box corners: the links of each arm in turn, then the objects.
        self._boxes = np.concatenate([*arms, np.array(boxes).reshape(-1, 8, 3)])
        ends = np.cumsum([0, *map(len, arms)]).tolist()
        self._rows = [slice(*ends_of_arm) for ends_of_arm in pairwise(ends)]
        self._object_rows = {name: ends[-1] + k for k, name in enumerate(self._names)}
        self._corners = np.zeros_like(self._boxes)
        self._moved_m = np.zeros(len(self._boxes))  # total travel since the first scene, in straight steps
        self._largest_travel_m = [0.0] * len(
            arms
        )  # the same, per arm: of its fastest piece or load in each step

    def overlap(self, scene: Scene, pair: tuple[int, int], touches: Touches) -> Nearest | None:
        """The deepest overlap of two arms with their loads in a scene; None where there is none."""
        planning_scene = self._advance(scene)
        loads = blocking_loads(scene, pair)
        allowed = allowed_contacts(pair, loads, touches)
        last_test = self._last_tests.get(pair)
        if last_test is not None and (last_test.loads, last_test.allowed) == (loads, allowed):
            if self._pair_travel_m(pair) < last_test.until_m:
                return None
            a, b = (
                self._travel_m(agent, load) - before_m
                for agent, load, before_m in zip(pair, loads, last_test.moved_m, strict=True)
            )
            if (last_test.bounds_m - a[:, None] - b).min() > 0:
                return None
        self._last_tests.pop(pair, None)
        bodies = measured_pair(planning_scene, pair, touches)
        bounds_m = _bounds_m(*bodies)
        if bounds_m.min() <= 0 and (deepest := overlap(*bodies)) is not None:
            return deepest
        if {*loads} <= {None, *self._object_rows}:  # the travel of other loads is not tracked
            travel_a_m, travel_b_m = (
                self._travel_m(*load_of_agent) for load_of_agent in zip(pair, loads, strict=True)
            )
            until_m = self._pair_travel_m(pair) + float(bounds_m.min())
            self._last_tests[pair] = _ExactTest(loads, allowed, bounds_m, until_m, (travel_a_m, travel_b_m))
        return None

    def _advance(self, scene: Scene) -> PlanningScene:
        """The planning scene of a new scene; adds the travel since the last scene to the totals."""
        last = self._current
        if last is not None and last.scene is scene:
            return last
        current = PlanningScene(self._task, scene)
        object_poses = np.array([scene.poses[name] for name in self._names]).reshape(-1, 4, 4)
        body = np.concatenate([*current.links, object_poses])
        corners = transform_by_poses(body, self._boxes)
        if last is not None:
            moved_m = np.sqrt(((corners - self._corners) ** 2).sum(axis=-1).max(axis=-1))
            self._moved_m += moved_m
            for k, (rows, held) in enumerate(zip(self._rows, scene.held, strict=True)):
                load_m = moved_m[self._object_rows[held]] if held in self._object_rows else 0.0
                self._largest_travel_m[k] += max(float(moved_m[rows].max()), float(load_m))
        self._current, self._corners = current, corners
        return current

    def _pair_travel_m(self, pair: tuple[int, int]) -> float:
        return self._largest_travel_m[pair[0] - 1] + self._largest_travel_m[pair[1] - 1]

    def _travel_m(self, agent: int, load: Load) -> NDArray[np.float64]:
        """Total travel of the pieces of an arm and its load, in the order of its body."""
        links = self._moved_m[self._rows[agent - 1]]
        mounted = self._task.robots[agent - 1].mounted
        attached_m: list[NDArray[np.float64]] = []
        if mounted:
            robot = self._task.arms[agent].robot
            hand = links[robot.links.index(robot.hand.link)]
            attached_m.append(np.full(len(asset_pieces(mounted)), hand))
        if load is not None:
            pieces = len(asset_pieces(self._task.asset(load)))
            attached_m.append(np.full(pieces, self._moved_m[self._object_rows[load]]))
        return np.concatenate([links, *attached_m])


def _bounds_m(a: Swept, b: Swept) -> NDArray[np.float64]:
    """Lower bounds (La, Lb) on the distances of pieces; infinite for near pieces that may touch."""
    gaps = cdist(a.centres[0], b.centres[0]) - a.radii_m[:, None] - b.radii_m
    apart = must_keep_apart(a, b)
    for i, j in np.argwhere(gaps < NEAR_M).tolist():
        gaps[i, j] = exact_m(a, b, 0, 0, i, j) - SLACK_M if apart(a.labels[i], b.labels[j]) else np.inf
    return gaps
