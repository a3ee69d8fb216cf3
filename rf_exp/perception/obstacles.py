"""What the depth cameras see, as obstacles: boxes of voxels, whether or not the task knows what is there.

Cameras see surfaces. What is below a surface they see, down to the table, is taken to be filled, so that
the back of a thing, which no camera sees, is in the way as well.

Voxels are too coarse to work in. So an agent does not mind those of what its subgoals are about, and of
what somebody holds or moves; nor, close to these, those of other objects that the task knows. All of these
stand in for their voxels, with their measured poses. Nor does it mind the voxels it stands in itself.
Anything else that is seen is in the way.
"""

from collections.abc import Collection
from functools import cache

import numpy as np
import trimesh

from rf_exp.geometry import VOXEL_M, Piece, PlanningScene, Swept, Voxels, among, beside
from rf_exp.perception.depth import NOISE_M
from rf_exp.transforms import transform

SEEN = "something that the cameras see"
NEAR_M = VOXEL_M  # fingers need so much room round what they take or put down
STARTS_M = VOXEL_M / 2  # an arm stands free where it begins, however near a voxel comes to it


class Seen:
    """The voxels seen in a scene, and whose they may be."""

    def __init__(self, planning_scene: PlanningScene) -> None:
        scene, seen = planning_scene.scene, planning_scene.scene.seen
        assert seen is not None  # the cameras have looked
        self._occupied = occupied = down_to_table(seen)
        self._held = frozenset(name for name in scene.held if name)
        objects = {name: planning_scene.standing([name]) for name in planning_scene.task.objects}
        self._owned = {
            name: among(occupied, down_to_table(seen[beside(seen, body, NOISE_M)]))
            for name, body in objects.items()
        }
        self._near = {name: beside(occupied, body, NEAR_M) for name, body in objects.items()}
        self._known = np.any([np.zeros(len(occupied), dtype=bool), *self._owned.values()], axis=0)
        arms = (planning_scene.measured(agent) for agent in planning_scene.task.agents)
        self._starts = [beside(occupied, arm, STARTS_M) for arm in arms]
        self._found: dict[tuple[int, frozenset[str]], tuple[Swept, frozenset[str]]] = {}

    def obstacles(self, agent: int, minds_not: Collection[str]) -> tuple[Swept, frozenset[str]]:
        """What an agent has to avoid: boxes, one body, and the objects that stand in for voxels left out.

        `minds_not` names what its subgoals are about, and what somebody moves.
        """
        exactly = self._held | set(minds_not)
        key = agent, exactly
        if key not in self._found:
            left_out = self._starts[agent - 1].copy()
            for name in exactly:
                left_out |= self._owned[name] | (self._near[name] & self._known)
            owners = {name for name, owned in self._owned.items() if (owned & left_out).any()}
            self._found[key] = boxes(self._occupied[~left_out]), exactly | owners
        return self._found[key]


def down_to_table(seen: Voxels) -> Voxels:
    """Seen voxels (K, 3), above the table and in lexical order, with all that are below them."""
    top = np.append((seen[1:, :2] != seen[:-1, :2]).any(axis=1), np.ones(min(len(seen), 1), dtype=bool))
    columns = seen[top]
    height = columns[:, 2] + 1
    filled = columns.repeat(height, axis=0)
    filled[:, 2] = np.arange(len(filled)) - (height.cumsum() - height).repeat(height)
    return filled


def boxes(occupied: Voxels) -> Swept:
    """Voxels (K, 3) as one body (P = 1), neighbours joined to boxes on one axis after another."""
    low, high = occupied, occupied + 1
    for axis in range(3):
        low, high = _joined(low, high, axis)
    poses = np.tile(np.eye(4), (1, len(low), 1, 1))
    poses[0, :, :3, 3] = low * VOXEL_M
    pieces = tuple(_box(*size) for size in (high - low).tolist())
    return Swept(pieces, (SEEN,) * len(pieces), poses, objects=frozenset({SEEN}))


def together(a: Swept, b: Swept) -> Swept:
    """Two bodies that stand (P = 1) as one."""
    poses = np.concatenate([a.poses, b.poses], axis=1)
    return Swept(a.pieces + b.pieces, a.labels + b.labels, poses, objects=a.objects | b.objects)


def _joined(low: Voxels, high: Voxels, axis: int) -> tuple[Voxels, Voxels]:
    """Boxes (B, 3) from `low` to `high`, rows of equal ones on an axis joined."""
    across = [other for other in range(3) if other != axis]
    order = np.lexsort((low[:, axis], *low[:, across].T, *high[:, across].T))
    low, high = low[order], high[order].copy()
    sides = np.hstack([low[:, across], high[:, across]])
    begins = (sides[1:] != sides[:-1]).any(axis=1) | (low[1:, axis] != high[:-1, axis])
    edge = np.ones(min(len(low), 1), dtype=bool)
    first, last = np.concatenate([edge, begins]), np.concatenate([begins, edge])
    end = high[last][:, axis]
    low, high = low[first], high[first]
    high[:, axis] = end
    return low, high


@cache
def _box(x: int, y: int, z: int) -> Piece:
    """A box of so many voxels, its lowest corner at the origin."""
    size_m = np.array([x, y, z]) * VOXEL_M
    return Piece.of(trimesh.creation.box(size_m, transform(size_m / 2)))
