"""3-D occupancy from depth cameras and joint states (paper, section 3.2): what is there, whoever put it.

Every pixel becomes a point in the world. The table, and what is below it or out of every arm's reach, is
left out; so is what the joint states explain: the arms, and what they hold. What remains is somebody's
surface, and the voxels that it lies in are occupied, by objects of the task and by anything else alike.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry import VOXEL_M, PlanningScene, Swept, Voxels
from rf_exp.types import CameraModel

NOISE_M = 0.01  # a point this near to the table, an arm, or what it holds may be theirs
REACH_M = 1.2  # of an arm with its gripper and a load; what is farther from every base is in nobody's way
POINT_M = 0.01  # of all points in a cube of this edge one is looked at
FAR_M = 2.0  # so far from a camera the points of its pixels may be that far apart
FEWEST = 3  # such points that make a voxel occupied: of noise that goes far some always remains

Points = NDArray[np.float32]  # (K, 3) world frame


def look(
    depth: Mapping[str, NDArray[np.float32]],
    cameras: Mapping[str, CameraModel],
    planning_scene: PlanningScene,
) -> Voxels:
    """Voxels (K, 3) in which a camera sees a surface that is no table's and no arm's. In lexical order.

    `depth`: camera -> (H, W) metres along the viewing direction, 0 where nothing was measured, with the
    models of these cameras. The scene of `planning_scene` says where the arms are then, and what they hold.
    """
    bases_m = [robot.world_from_base[:2, 3] for robot in planning_scene.task.robots]
    seen = [points(depth[name], cameras[name]) for name in depth]
    found = _one_of_each_cube(np.concatenate([np.zeros((0, 3), dtype=np.float32), *seen]), POINT_M)
    away_m = [np.linalg.norm(found[:, :2] - base_m, axis=1) for base_m in bases_m]
    found = found[np.min(away_m, axis=0) < REACH_M]
    for agent, held in zip(planning_scene.task.agents, planning_scene.scene.held, strict=True):
        arm = planning_scene.measured(agent)
        for body in (arm, planning_scene.standing([held] if held else [])):
            found = found[~within(body, found, NOISE_M)]
    occupied, count = np.unique(np.floor(found / VOXEL_M).astype(np.int64), axis=0, return_counts=True)
    return occupied[count >= FEWEST]


def points(depth: NDArray[np.float32], camera: CameraModel) -> Points:
    """(K, 3) world positions of the pixels of a depth picture (H, W) that see something above the table.

    Of a fine picture every second pixel or fewer: as many as keep points `FAR_M` away `POINT_M` apart.
    """
    rotation, eye_m = camera.world_from_camera[:3, :3].astype(np.float32), camera.world_from_camera[:3, 3]
    every = max(1, int(POINT_M / FAR_M * camera.intrinsics[0, 0]))
    along_m = depth[::every, ::every].ravel()
    rays = _rays(camera.width_px, camera.height_px, camera.fov_y_rad, every)
    height_m = along_m * (rays @ rotation[2]) + np.float32(eye_m[2])
    above = (height_m > NOISE_M) & (along_m > 0) & np.isfinite(height_m)
    above = np.flatnonzero(above)  # few: most pixels see the table or the floor
    return (along_m[above, None] * (rays[above] @ rotation.T) + eye_m).astype(np.float32)


def within(body: Swept, found: Points, margin_m: float) -> NDArray[np.bool_]:
    """(K,) True for points (K, 3) in a body at its first position, or at most about `margin_m` outside.

    At an edge of a piece a little more: its faces, moved out by the margin, meet farther away.
    """
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


def _one_of_each_cube(found: Points, edge_m: float) -> Points:
    """The first point of all that lie in one cube of a grid."""
    if not len(found):
        return found
    x, y, z = np.floor((found - found.min(axis=0)) / np.float32(edge_m)).astype(np.int64).T
    _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
    return found[first]


@cache
def _rays(width_px: int, height_px: int, fov_y_rad: float, every: int) -> Points:
    """(K, 3) where the middles of pixels, one of `every` each way, are at depth 1; OpenCV axes."""
    camera = CameraModel(width_px, height_px, fov_y_rad, np.eye(4))
    u, v = np.meshgrid(np.arange(0, width_px, every) + 0.5, np.arange(0, height_px, every) + 0.5)
    pixels = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return (pixels @ np.linalg.inv(camera.intrinsics).T).astype(np.float32)
