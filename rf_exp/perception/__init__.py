"""Perception: occupied voxels from depth cameras, and the obstacles made of them (paper, section 3.2).

Every pixel becomes a point in the world. Points on or below the table or out of every arm's reach are left
out, and so are points that joint states explain: on the arms and on held objects. Voxels with remaining
points are occupied, by objects of the task or by anything else. The space below a surface, down to the table,
counts as occupied, so that the backs of objects, which no camera sees, are obstacles as well.

Voxels are too coarse for manipulation. An agent therefore ignores the voxels of the objects of its subgoals
and of objects that any agent holds or moves, and, close to these, the voxels of other objects of the task.
For all of these objects their measured poses are used instead. It also ignores the voxels at its own arm's
start. All other occupied voxels are obstacles.
"""

from collections.abc import Collection, Mapping
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from rf_exp.geometry import VOXEL_M, Piece, PlanningScene, Swept, Voxels, among, beside
from rf_exp.transforms import transform
from rf_exp.types import CameraModel

__all__ = ["SEEN", "Seen", "down_to_table", "look"]

NOISE_M = 0.01  # points this near to the table, an arm or a held object are assigned to it
REACH_M = 1.2  # of an arm with gripper and load; points farther from every base are left out
POINT_M = 0.01  # edge of the grid cells that keep one point each
FAR_M = 2.0  # distance from a camera at which its points may be POINT_M apart
FEWEST = 3  # least points of an occupied voxel: some outliers of depth noise always remain
SEEN = "something that the cameras see"
NEAR_M = VOXEL_M  # clearance that fingers need around an object they grasp or put down
STARTS_M = VOXEL_M / 2  # voxels this near to an arm's start are ignored: it starts collision-free

Points = NDArray[np.float32]  # (K, 3) world frame


def look(
    depth: Mapping[str, NDArray[np.float32]],
    cameras: Mapping[str, CameraModel],
    planning_scene: PlanningScene,
) -> Voxels:
    """Voxels (K, 3) with a visible surface that is not the table, an arm or a held object, in lexical order.

    `depth`: camera -> (H, W) metres along the viewing direction, 0 where nothing was measured; `cameras` has
    the models of these cameras, and the scene of `planning_scene` the arms and held objects at that time.
    """
    bases_m = [robot.world_from_base[:2, 3] for robot in planning_scene.task.robots]
    seen = [points(depth[name], cameras[name]) for name in depth]
    found = _one_of_each_cube(np.concatenate([np.zeros((0, 3), dtype=np.float32), *seen]))
    away_m = [np.linalg.norm(found[:, :2] - base_m, axis=1) for base_m in bases_m]
    found = found[np.min(away_m, axis=0) < REACH_M]
    for agent, held in zip(planning_scene.task.agents, planning_scene.scene.held, strict=True):
        for body in (planning_scene.measured(agent), planning_scene.standing([held] if held else [])):
            found = found[~within(body, found, NOISE_M)]
    occupied, count = np.unique(np.floor(found / VOXEL_M).astype(np.int64), axis=0, return_counts=True)
    return occupied[count >= FEWEST]


def points(depth: NDArray[np.float32], camera: CameraModel) -> Points:
    """World positions (K, 3) of the pixels of a depth picture (H, W) above the table.

    Fine pictures are subsampled such that points at `FAR_M` are at most `POINT_M` apart.
    """
    rotation, eye_m = camera.world_from_camera[:3, :3].astype(np.float32), camera.world_from_camera[:3, 3]
    every = max(1, int(POINT_M / FAR_M * camera.intrinsics[0, 0]))
    along_m = depth[::every, ::every].ravel()
    rays = _rays(camera.width_px, camera.height_px, camera.fov_y_rad, every)
    height_m = along_m * (rays @ rotation[2]) + np.float32(eye_m[2])
    # Select first: most pixels show the table or the floor.
    above = np.flatnonzero((height_m > NOISE_M) & (along_m > 0) & np.isfinite(height_m))
    return (along_m[above, None] * (rays[above] @ rotation.T) + eye_m).astype(np.float32)


def within(body: Swept, found: Points, margin_m: float) -> NDArray[np.bool_]:
    """Mask (K,) of points (K, 3) in a body at its first position, or within about `margin_m` of its faces."""
    inside = np.zeros(len(found), dtype=bool)
    for column, piece in enumerate(body.pieces):
        pose = body.poses[0, column].astype(np.float32)
        away = found - body.centres[0, column].astype(np.float32)
        near = np.flatnonzero(np.einsum("ki,ki->k", away, away) < (piece.radius_m + margin_m) ** 2)
        near = near[~inside[near]]
        local = (found[near] - pose[:3, 3]) @ pose[:3, :3]
        planes = piece.planes.astype(np.float32)
        inside[near] = (local @ planes[:, :3].T + planes[:, 3]).max(axis=1, initial=-np.inf) <= margin_m
    return inside


def _one_of_each_cube(found: Points) -> Points:
    """The first point in each cell of a grid of `POINT_M`."""
    if not len(found):
        return found
    x, y, z = np.floor((found - found.min(axis=0)) / np.float32(POINT_M)).astype(np.int64).T
    _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
    return found[first]


@cache
def _rays(width_px: int, height_px: int, fov_y_rad: float, every: int) -> Points:
    """Centres (K, 3) of every `every`-th pixel along both axes, at depth 1; OpenCV axes."""
    camera = CameraModel(width_px, height_px, fov_y_rad, np.eye(4))
    u, v = np.meshgrid(np.arange(0, width_px, every) + 0.5, np.arange(0, height_px, every) + 0.5)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return (pixels @ np.linalg.inv(camera.intrinsics).T).astype(np.float32)


class Seen:
    """Occupied voxels of a scene, and the objects that they may belong to."""

    def __init__(self, planning_scene: PlanningScene) -> None:
        scene, seen = planning_scene.scene, planning_scene.scene.seen
        assert seen is not None  # only for scenes with depth pictures
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
        """Obstacles of an agent: occupied boxes as one body, and the objects that replace ignored voxels.

        `minds_not` names the objects of its subgoals and the objects that any agent moves.
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
    """Voxels (K, 3), above the table and in lexical order, and all voxels below them down to the table."""
    top = np.append((seen[1:, :2] != seen[:-1, :2]).any(axis=1), np.ones(min(len(seen), 1), dtype=bool))
    columns = seen[top]
    height = columns[:, 2] + 1
    filled = columns.repeat(height, axis=0)
    filled[:, 2] = np.arange(len(filled)) - (height.cumsum() - height).repeat(height)
    return filled


def boxes(occupied: Voxels) -> Swept:
    """Voxels (K, 3) as one body (P = 1); neighbours are merged to boxes along one axis after another."""
    low, high = occupied, occupied + 1
    for axis in range(3):
        low, high = _joined(low, high, axis)
    poses = np.tile(np.eye(4), (1, len(low), 1, 1))
    poses[0, :, :3, 3] = low * VOXEL_M
    pieces = tuple(_box(*size) for size in (high - low).tolist())
    return Swept(pieces, (SEEN,) * len(pieces), poses, objects=frozenset({SEEN}))


def _joined(low: Voxels, high: Voxels, axis: int) -> tuple[Voxels, Voxels]:
    """Boxes (B, 3) from `low` to `high`, with adjacent equal ones merged along an axis."""
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
    """A box of x, y, z voxels, its lowest corner at the origin."""
    size_m = np.array([x, y, z]) * VOXEL_M
    return Piece.of(trimesh.creation.box(size_m, transform(size_m / 2)))
