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

from rf_exp.geometry.clearance import SLACK_M, Nearest, apart_now, exact_m, overlap
from rf_exp.geometry.planning_scene import PlanningScene
from rf_exp.geometry.swept import Swept, arm_pieces, asset_pieces
from rf_exp.tasks import Task
from rf_exp.transforms import placed
from rf_exp.types import Scene

NEAR_M = 0.1  # pieces with bounding spheres closer than this are measured exactly

Load = str | None
Touches = Callable[[int], frozenset[str]]  # agent -> objects that its gripper and its load may touch
EMPTY: tuple[Load, ...] = (None, None)
NOTHING = (frozenset[str](), frozenset[str]())


@dataclass(frozen=True)
class _Looked:
    """Result of the last exact test of a pair of arms."""

    loads: tuple[Load, ...]
    may: tuple[frozenset[str], ...]  # allowed contacts of each arm
    bounds_m: NDArray[np.float64]  # (La, Lb), see `_bounds_m`
    until_m: float  # total travel of both arms below which all bounds stay positive
    moved_m: tuple[NDArray[np.float64], NDArray[np.float64]]  # (La,), (Lb,) total travel of pieces by then


def loads_of(scene: Scene, pair: tuple[int, int]) -> tuple[Load, ...]:
    """Objects held by two arms that are obstacles to the other arm; an object held by both is none."""
    held = scene.held[pair[0] - 1], scene.held[pair[1] - 1]
    return held if held[0] != held[1] else EMPTY


def may_of(pair: tuple[int, int], loads: tuple[Load, ...], touches: Touches) -> tuple[frozenset[str], ...]:
    """Allowed contacts of two arms; empty for arms without loads, as links must always keep apart."""
    return NOTHING if loads == EMPTY else (touches(pair[0]), touches(pair[1]))


def measured_pair(
    planning_scene: PlanningScene, pair: tuple[int, int], touches: Touches
) -> tuple[Swept, Swept]:
    """Two measured arms, each with its load."""
    loads = loads_of(planning_scene.scene, pair)
    one, other = (
        planning_scene.measured(agent, attached=load, touches=may)
        for agent, load, may in zip(pair, loads, may_of(pair, loads, touches), strict=True)
    )
    return one, other


class Separation:
    """Incremental `overlap` of two measured arms over successive scenes, at a fraction of its cost.

    Scenes may come in any order; it is fast when successive scenes differ little.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._now: PlanningScene | None = None
        self._looked: dict[tuple[int, int], _Looked] = {}
        arms = [np.stack([piece.corners for piece in arm_pieces(arm.robot)]) for arm in task.arms.values()]
        self._names = [name for name in task.objects if asset_pieces(task.asset(name))]
        boxes = [trimesh.bounds.corners(task.asset(name).bounds_m) for name in self._names]
        # (B, 8, 3) bounding-box corners: the links of each arm in turn, then the objects.
        self._boxes = np.concatenate([*arms, np.array(boxes).reshape(-1, 8, 3)])
        ends = np.cumsum([0, *map(len, arms)]).tolist()
        self._rows = [slice(*each) for each in pairwise(ends)]
        self._objects = {name: ends[-1] + k for k, name in enumerate(self._names)}
        self._corners = np.zeros_like(self._boxes)
        self._moved_m = np.zeros(len(self._boxes))  # total travel since the first scene, in straight steps
        self._farthest_m = [0.0] * len(arms)  # the same, per arm: of its fastest piece or load in each step

    def overlap(self, scene: Scene, pair: tuple[int, int], touches: Touches) -> Nearest | None:
        """The deepest overlap of two arms with their loads in a scene; None where there is none."""
        planning_scene = self._seen(scene)
        loads = loads_of(scene, pair)
        may = may_of(pair, loads, touches)
        known = self._looked.get(pair)
        if known is not None and (known.loads, known.may) == (loads, may):
            if self._of_both(pair) < known.until_m:
                return None
            a, b = (
                self._of(agent, load) - was
                for agent, load, was in zip(pair, loads, known.moved_m, strict=True)
            )
            if (known.bounds_m - a[:, None] - b).min() > 0:
                return None
        self._looked.pop(pair, None)
        bodies = measured_pair(planning_scene, pair, touches)
        bounds_m = _bounds_m(*bodies)
        if bounds_m.min() <= 0 and (found := overlap(*bodies)) is not None:
            return found
        if {*loads} <= {None, *self._objects}:  # the travel of other loads is not tracked
            one, other = (self._of(*each) for each in zip(pair, loads, strict=True))
            until_m = self._of_both(pair) + float(bounds_m.min())
            self._looked[pair] = _Looked(loads, may, bounds_m, until_m, (one, other))
        return None

    def _seen(self, scene: Scene) -> PlanningScene:
        """The planning scene of a new scene; adds the travel since the last scene to the totals."""
        before = self._now
        if before is not None and before.scene is scene:
            return before
        now = PlanningScene(self._task, scene)
        things = np.array([scene.poses[name] for name in self._names]).reshape(-1, 4, 4)
        body = np.concatenate([*now.links, things])
        corners = placed(body, self._boxes)
        if before is not None:
            moved_m = np.sqrt(((corners - self._corners) ** 2).sum(axis=-1).max(axis=-1))
            self._moved_m += moved_m
            for k, (rows, held) in enumerate(zip(self._rows, scene.held, strict=True)):
                load_m = moved_m[self._objects[held]] if held in self._objects else 0.0
                self._farthest_m[k] += max(float(moved_m[rows].max()), float(load_m))
        self._now, self._corners = now, corners
        return now

    def _of_both(self, pair: tuple[int, int]) -> float:
        return self._farthest_m[pair[0] - 1] + self._farthest_m[pair[1] - 1]

    def _of(self, agent: int, load: Load) -> NDArray[np.float64]:
        """Total travel of the pieces of an arm and its load, in the order of its body."""
        links = self._moved_m[self._rows[agent - 1]]
        mounted = self._task.robots[agent - 1].mounted
        more: list[NDArray[np.float64]] = []
        if mounted:
            robot = self._task.arms[agent].robot
            hand = links[robot.links.index(robot.hand.link)]
            more.append(np.full(len(asset_pieces(mounted)), hand))
        if load is not None:
            pieces = len(asset_pieces(self._task.asset(load)))
            more.append(np.full(pieces, self._moved_m[self._objects[load]]))
        return np.concatenate([links, *more])


def _bounds_m(a: Swept, b: Swept) -> NDArray[np.float64]:
    """Lower bounds (La, Lb) on the distances of pieces; infinite for near pieces that may touch."""
    gaps = cdist(a.centres[0], b.centres[0]) - a.radii_m[:, None] - b.radii_m
    apart = apart_now(a, b)
    for i, j in np.argwhere(gaps < NEAR_M).tolist():
        gaps[i, j] = exact_m(a, b, 0, 0, i, j) - SLACK_M if apart(a.labels[i], b.labels[j]) else np.inf
    return gaps
