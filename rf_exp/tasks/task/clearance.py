"""Clearance at the start: whether arms stand in nothing, before anything is planned or simulated."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.transforms import Matrix, apply, inverse

if TYPE_CHECKING:
    import trimesh

    from rf_exp.tasks.task.task import Task

CLEAR_M = 0.01  # between an arm and what it does not hold


def stands_in(task: "Task", qpos: NDArray[np.float64], poses: Mapping[str, Matrix]) -> str | None:
    """Which object, of those at `poses`, an arm at qpos (N, D) is nearer to than CLEAR_M; None: to none.

    By corners of one in the other, both ways: links and things are convex pieces with many corners.
    """
    pieces = [(name, pose, hull) for name, pose in poses.items() for hull in task.asset(name).hulls]
    for row, arm in zip(qpos, task.arms.values(), strict=True):
        links = dict(zip(arm.robot.links, arm.links(row[None])[0], strict=True))
        for link, link_hull in arm.robot.hulls.items():
            for name, pose, hull in pieces:
                link_from_object = inverse(links[link]) @ pose
                if _far(link_hull, hull, link_from_object):
                    continue
                if _within(link_hull, apply(link_from_object, hull.vertices)) or _within(
                    hull, apply(inverse(link_from_object), link_hull.vertices)
                ):
                    return name
    return None


def _far(one: "trimesh.Trimesh", other: "trimesh.Trimesh", one_from_other: Matrix) -> bool:
    """Whether the spheres round two meshes are farther apart than CLEAR_M."""
    between = apply(one_from_other, other.bounds.mean(axis=0)) - one.bounds.mean(axis=0)
    radii_m = (np.linalg.norm(one.extents) + np.linalg.norm(other.extents)) / 2
    return bool(np.linalg.norm(between) > radii_m + CLEAR_M)


def _within(hull: "trimesh.Trimesh", points: NDArray[np.float64]) -> bool:
    """Whether a point (K, 3) is inside of a convex mesh, or nearer to it than CLEAR_M."""
    outside_m = points @ hull.face_normals.T - (hull.triangles_center * hull.face_normals).sum(axis=1)
    return bool((outside_m.max(axis=1) < CLEAR_M).any())
