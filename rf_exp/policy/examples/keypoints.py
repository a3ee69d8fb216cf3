"""Keypoint labels: the TCP at the gripper changes of a demonstration, projected into the pictures.

The keypoints of a stream are, for each of its agents, the TCP at each change of its gripper, in their order,
and at the end of the episode; then the current TCPs of these and of all other agents. No object pose is used:
all follows from stored joints and commands, and the camera calibration.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.inputs.observation_spec import (
    ObservationSpec,
    finger_openings,
    footprint,
    gripper_changes,
    other_agents,
    world_from_tcp,
)
from rf_exp.policy.inputs.pictures import calibrations, inside_picture, rays_of
from rf_exp.policy.inputs.rows import intended_commands, measured_joints
from rf_exp.policy.inputs.view import Stream
from rf_exp.transforms import apply, inverse, transform_by_poses
from rf_exp.types import ARM_JOINTS, CameraModel

if TYPE_CHECKING:
    from rf_exp.store import Store

# Points of a gripper, m in the TCP frame: the TCP, and one across the fingers' axis, where tools work.
GRIPPER_POINTS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
# Cosine and sine of one, two and four times the heading of the fingers (a cube has four sides).
HEADING_SIZE = 6


class Keypoints(NamedTuple):
    """M keypoints of P points of GRIPPER_POINTS each, in T frames of a stream; NaN where one is past.

    With several cameras side by side: all keypoints in the first, then in the second, ...
    """

    pixels: NDArray[np.float32]  # (T, M * P, 2) x to the right and y down, from 0 to 1 over the picture
    points: NDArray[np.float32]  # (T, M * P, 3) m, in the footprint of the stream's first agent
    headings: NDArray[np.float32]  # (T, M, HEADING_SIZE)
    rays: NDArray[np.float32]  # (T, K, 3, 4) of the K cameras, see `rays_of`


def keypoints(
    store: "Store", stream: Stream, spec: ObservationSpec, selection: NDArray[np.bool_] | slice
) -> Keypoints:
    """The keypoints of the kept frames of a store. Raises ArgumentError as `usual_calibration`."""
    episode_calibrations = calibrations(store, stream.cameras)
    pixels, points, headings, rays = [], [], [], []
    episodes = zip(
        store.by_episode(measured_joints(store)),
        store.by_episode(intended_commands(store)),
        episode_calibrations,
        strict=True,
    )
    for qpos, action, calibration in episodes:
        bases, cameras = calibration.world_from_base, calibration.cameras.values()
        columns = []
        for agent in stream.agents:
            tcp = world_from_tcp(spec, bases, agent, qpos)
            change_steps = gripper_changes(
                action[:, agent - 1, ARM_JOINTS], finger_openings(qpos)[:, agent - 1]
            )
            columns += _own_keyframes(tcp, change_steps, spec.keyframes)
        present_agents = *stream.agents, *other_agents(spec, stream)
        columns += [world_from_tcp(spec, bases, agent, qpos) for agent in present_agents]
        world_from_tcps = np.stack(columns, axis=1)  # (T, M, 4, 4)
        world_points = transform_by_poses(world_from_tcps, GRIPPER_POINTS).reshape(
            len(world_from_tcps), -1, 3
        )
        footprint_from_world = inverse(footprint(bases[stream.agents[0] - 1]))
        projected = [
            _side_by_side(_project(world_points, camera), number, len(cameras))
            for number, camera in enumerate(cameras)
        ]
        pixels.append(np.concatenate(projected, axis=1))
        points.append(apply(footprint_from_world, world_points).astype(np.float32))
        headings.append(_heading_features(footprint_from_world @ world_from_tcps).astype(np.float32))
        rays.append(np.repeat(rays_of(calibration, stream)[None], len(qpos), axis=0))
    per_camera = 1, len(stream.cameras), 1
    return Keypoints(
        np.concatenate(pixels)[selection],
        np.tile(np.concatenate(points)[selection], per_camera),
        np.tile(np.concatenate(headings)[selection], per_camera),
        np.concatenate(rays)[selection],
    )


def gripper_shape(footprint_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gripper poses (..., 4, 4) -> the TCP and the other GRIPPER_POINTS relative to it, in m, and heading."""
    points = transform_by_poses(footprint_from_tcp, GRIPPER_POINTS)
    points[..., 1:, :] -= points[..., :1, :]
    flat = points.reshape(*points.shape[:-2], -1)
    return np.concatenate([flat, _heading_features(footprint_from_tcp)], axis=-1)


def _heading_features(footprint_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Headings of gripper poses: (..., 4, 4) -> (..., HEADING_SIZE)."""
    fingers = footprint_from_tcp[..., :2, 1]  # the axis along which they move
    heading = np.arctan2(fingers[..., 1], fingers[..., 0])
    values = np.concatenate([[np.cos(k * heading), np.sin(k * heading)] for k in (1, 2, 4)])
    return np.moveaxis(values, 0, -1)


def _side_by_side(pixels: NDArray[np.float64], row: int, count: int) -> NDArray[np.float32]:
    """Places (..., 2) in picture `row` of `count` of equal size -> in all of them, side by side."""
    if count > 1:
        inside = inside_picture(pixels)[..., None]
        pixels = np.where(inside, (pixels + np.array([row, 0])) / np.array([count, 1]), np.nan)
    return pixels.astype(np.float32)


def _own_keyframes(
    tcp: NDArray[np.float64], change_steps: NDArray[np.int64], keyframes: int
) -> list[NDArray[np.float64]]:
    """Keypoints (T, 4, 4) of an agent in one episode: at each change, NaN after it, and at the end."""
    steps = np.arange(len(tcp))
    columns = []
    for key in range(keyframes):
        column = np.full_like(tcp, np.nan)
        if key < len(change_steps):
            column[steps <= change_steps[key]] = tcp[change_steps[key]]
        columns.append(column)
    return [*columns, np.broadcast_to(tcp[-1], tcp.shape)]


def _project(points: NDArray[np.float64], camera: CameraModel) -> NDArray[np.float64]:
    """World points (..., 3) -> (..., 2) from 0 to 1 over the picture; NaN behind the camera."""
    projected = apply(inverse(camera.world_from_camera), points) @ camera.intrinsics.T
    depth = np.where(projected[..., 2:] > 1e-3, projected[..., 2:], np.nan)
    return projected[..., :2] / depth / (camera.width_px, camera.height_px)
