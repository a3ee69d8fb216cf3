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

from rf_exp.geometry import VOXEL_M, Piece, PlanningScene, Swept, Voxels, contained_in, within_margin
from rf_exp.transforms import transform
from rf_exp.types import CameraModel

__all__ = ["UNKNOWN_OBSTACLE", "OccupancyMap", "down_to_table", "occupied_voxels"]

NOISE_M = 0.01  # points this near to the table, an arm or a held object are assigned to it
REACH_M = 1.2  # of an arm with gripper and load; points farther from every base are left out
POINT_SPACING_M = 0.01  # edge of the grid cells that keep one point each
REFERENCE_DISTANCE_M = 2.0  # distance from a camera at which its points may be POINT_SPACING_M apart
MIN_POINTS = 3  # least points of an occupied voxel: some outliers of depth noise always remain
UNKNOWN_OBSTACLE = "something that the cameras see"
OBJECT_CLEARANCE_M = VOXEL_M  # clearance that fingers need around an object they grasp or put down
START_CLEARANCE_M = VOXEL_M / 2  # voxels this near to an arm's start are ignored: it starts collision-free

Points = NDArray[np.float32]  # (K, 3) world frame


def occupied_voxels(
    depth: Mapping[str, NDArray[np.float32]],
    cameras: Mapping[str, CameraModel],
    planning_scene: PlanningScene,
) -> Voxels:
    """Voxels (K, 3) with a visible surface that is not the table, an arm or a held object, in lexical order.

    `depth`: camera -> (H, W) metres along the viewing direction, 0 where nothing was measured; `cameras` has
    the models of these cameras, and the scene of `planning_scene` the arms and held objects at that time.
    """
    bases_m = [robot.world_from_base[:2, 3] for robot in planning_scene.task.robots]
    point_clouds = [depth_points(depth[name], cameras[name]) for name in depth]
    points = _subsampled(np.concatenate([np.zeros((0, 3), dtype=np.float32), *point_clouds]))
    distances_m = [np.linalg.norm(points[:, :2] - base_m, axis=1) for base_m in bases_m]
    points = points[np.min(distances_m, axis=0) < REACH_M]
    for agent, held in zip(planning_scene.task.agents, planning_scene.scene.held, strict=True):
        for body in (planning_scene.measured(agent), planning_scene.static_objects([held] if held else [])):
            points = points[~near_body(body, points, NOISE_M)]
    voxels, counts = np.unique(np.floor(points / VOXEL_M).astype(np.int64), axis=0, return_counts=True)
    return voxels[counts >= MIN_POINTS]


def depth_points(depth: NDArray[np.float32], camera: CameraModel) -> Points:
    """World positions (K, 3) of the pixels of a depth picture (H, W) above the table.

    Fine pictures are subsampled: points at `REFERENCE_DISTANCE_M` are at most `POINT_SPACING_M` apart.
    """
    rotation, eye_m = camera.world_from_camera[:3, :3].astype(np.float32), camera.world_from_camera[:3, 3]
    stride = max(1, int(POINT_SPACING_M / REFERENCE_DISTANCE_M * camera.intrinsics[0, 0]))
    depth_m = depth[::stride, ::stride].ravel()
    rays = _rays(camera.width_px, camera.height_px, camera.fov_y_rad, stride)
    height_m = depth_m * (rays @ rotation[2]) + np.float32(eye_m[2])
    # Select first: most pixels show the table or the floor.
    above = np.flatnonzero((height_m > NOISE_M) & (depth_m > 0) & np.isfinite(height_m))
    return (depth_m[above, None] * (rays[above] @ rotation.T) + eye_m).astype(np.float32)


def near_body(body: Swept, points: Points, margin_m: float) -> NDArray[np.bool_]:
    """Mask (K,) of points (K, 3) in a body at its first position, or within about `margin_m` of its faces."""
    inside = np.zeros(len(points), dtype=bool)
    for column, piece in enumerate(body.pieces):
        pose = body.poses[0, column].astype(np.float32)
        offsets = points - body.centres[0, column].astype(np.float32)
        candidates = np.flatnonzero(
            np.einsum("ki,ki->k", offsets, offsets) < (piece.radius_m + margin_m) ** 2
        )
        candidates = candidates[~inside[candidates]]
        local = (points[candidates] - pose[:3, 3]) @ pose[:3, :3]
        planes = piece.planes.astype(np.float32)
        inside[candidates] = (local @ planes[:, :3].T + planes[:, 3]).max(axis=1, initial=-np.inf) <= margin_m
    return inside


def _subsampled(points: Points) -> Points:
    """The first point in each cell of a grid of `POINT_SPACING_M`."""
    if not len(points):
        return points
    x, y, z = np.floor((points - points.min(axis=0)) / np.float32(POINT_SPACING_M)).astype(np.int64).T
    _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
    return points[first]


@cache
def _rays(width_px: int, height_px: int, fov_y_rad: float, stride: int) -> Points:
    """Centres (K, 3) of every `stride`-th pixel along both axes, at depth 1; OpenCV axes."""
    camera = CameraModel(width_px, height_px, fov_y_rad, np.eye(4))
    u, v = np.meshgrid(np.arange(0, width_px, stride) + 0.5, np.arange(0, height_px, stride) + 0.5)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return (pixels @ np.linalg.inv(camera.intrinsics).T).astype(np.float32)


class OccupancyMap:
    """Occupied voxels of a scene, and the objects that they may belong to."""

    def __init__(self, planning_scene: PlanningScene) -> None:
        scene, surface = planning_scene.scene, planning_scene.scene.occupied_voxels
        assert surface is not None  # only for scenes with depth pictures
        self._occupied = occupied = down_to_table(surface)
        self._held = frozenset(name for name in scene.held if name)
        objects = {name: planning_scene.static_objects([name]) for name in planning_scene.task.objects}
        self._object_voxels = {
            name: contained_in(occupied, down_to_table(surface[within_margin(surface, body, NOISE_M)]))
            for name, body in objects.items()
        }
        self._near_voxels = {
            name: within_margin(occupied, body, OBJECT_CLEARANCE_M) for name, body in objects.items()
        }
        self._task_voxels = np.any(
            [np.zeros(len(occupied), dtype=bool), *self._object_voxels.values()], axis=0
        )
        arms = (planning_scene.measured(agent) for agent in planning_scene.task.agents)
        self._start_voxels = [within_margin(occupied, arm, START_CLEARANCE_M) for arm in arms]
        self._cache: dict[tuple[int, frozenset[str]], tuple[Swept, frozenset[str]]] = {}

    def obstacles(self, agent: int, ignored_objects: Collection[str]) -> tuple[Swept, frozenset[str]]:
        """Obstacles of an agent: occupied boxes as one body, and the objects that replace ignored voxels.

        `ignored_objects` are the objects of its subgoals and the objects that any agent moves.
        """
        exact_objects = self._held | set(ignored_objects)
        key = agent, exact_objects
        if key not in self._cache:
            ignored = self._start_voxels[agent - 1].copy()
            for name in exact_objects:
                ignored |= self._object_voxels[name] | (self._near_voxels[name] & self._task_voxels)
            owners = {name for name, owned in self._object_voxels.items() if (owned & ignored).any()}
            self._cache[key] = boxes(self._occupied[~ignored]), exact_objects | owners
        return self._cache[key]


def down_to_table(surface: Voxels) -> Voxels:
    """Voxels (K, 3), above the table and in lexical order, and all voxels below them down to the table."""
    tops = np.append(
        (surface[1:, :2] != surface[:-1, :2]).any(axis=1), np.ones(min(len(surface), 1), dtype=bool)
    )
    columns = surface[tops]
    height = columns[:, 2] + 1
    filled = columns.repeat(height, axis=0)
    filled[:, 2] = np.arange(len(filled)) - (height.cumsum() - height).repeat(height)
    return filled


def boxes(voxels: Voxels) -> Swept:
    """Voxels (K, 3) as one body (P = 1); neighbours are merged to boxes along one axis after another."""
    low, high = voxels, voxels + 1
    for axis in range(3):
        low, high = _merged(low, high, axis)
    poses = np.tile(np.eye(4), (1, len(low), 1, 1))
    poses[0, :, :3, 3] = low * VOXEL_M
    pieces = tuple(_box(*size) for size in (high - low).tolist())
    return Swept(pieces, (UNKNOWN_OBSTACLE,) * len(pieces), poses, objects=frozenset({UNKNOWN_OBSTACLE}))


def _merged(low: Voxels, high: Voxels, axis: int) -> tuple[Voxels, Voxels]:
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
