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
    changes,
    footprint,
    others,
    widths,
    world_from_tcp,
)
from rf_exp.policy.inputs.pictures import calibrations, inside_picture, rays_of
from rf_exp.policy.inputs.rows import meant, measured
from rf_exp.policy.inputs.view import Stream
from rf_exp.transforms import apply, inverse, placed
from rf_exp.types import ARM_JOINTS, CameraModel

if TYPE_CHECKING:
    from rf_exp.store import Store

# Points of a gripper, m in the TCP frame: the TCP, and one across the fingers' axis, where tools work.
HAND = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
HEADING = 6  # cosine and sine of one, two and four times the heading of the fingers (a cube has four sides)


class Keypoints(NamedTuple):
    """M keypoints of P points of HAND each, in T frames of a stream; NaN where one is past.

    With several cameras side by side: all keypoints in the first, then in the second, ...
    """

    pixels: NDArray[np.float32]  # (T, M * P, 2) x to the right and y down, from 0 to 1 over the picture
    points: NDArray[np.float32]  # (T, M * P, 3) m, in the footprint of the stream's first agent
    headings: NDArray[np.float32]  # (T, M, HEADING)
    rays: NDArray[np.float32]  # (T, K, 3, 4) of the K cameras, see `rays_of`


def keypoints(
    store: "Store", stream: Stream, spec: ObservationSpec, kept: NDArray[np.bool_] | slice
) -> Keypoints:
    """The keypoints of the kept frames of a store. Raises ArgumentError as `usual_calibration`."""
    stands = calibrations(store, stream.cameras)
    pixels, points, headings, rays = [], [], [], []
    episodes = zip(store.by_episode(measured(store)), store.by_episode(meant(store)), stands, strict=True)
    for qpos, action, calibration in episodes:
        bases, cameras = calibration.world_from_base, calibration.cameras.values()
        columns = []
        for agent in stream.agents:
            tcp = world_from_tcp(spec, bases, agent, qpos)
            changed = changes(action[:, agent - 1, ARM_JOINTS], widths(qpos)[:, agent - 1])
            columns += _own(tcp, changed, spec.keyframes)
        now = *stream.agents, *others(spec, stream)
        columns += [world_from_tcp(spec, bases, agent, qpos) for agent in now]
        hands = np.stack(columns, axis=1)  # (T, M, 4, 4)
        world = placed(hands, HAND).reshape(len(hands), -1, 3)
        footprint_from_world = inverse(footprint(bases[stream.agents[0] - 1]))
        seen = [_placed(_project(world, c), k, len(cameras)) for k, c in enumerate(cameras)]
        pixels.append(np.concatenate(seen, axis=1))
        points.append(apply(footprint_from_world, world).astype(np.float32))
        headings.append(_turns(footprint_from_world @ hands).astype(np.float32))
        rays.append(np.repeat(rays_of(calibration, stream)[None], len(qpos), axis=0))
    of_cameras = 1, len(stream.cameras), 1
    return Keypoints(
        np.concatenate(pixels)[kept],
        np.tile(np.concatenate(points)[kept], of_cameras),
        np.tile(np.concatenate(headings)[kept], of_cameras),
        np.concatenate(rays)[kept],
    )


def shape_of_hand(footprint_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gripper poses (..., 4, 4) -> the TCP and the other points of HAND relative to it, in m, and heading."""
    points = placed(footprint_from_tcp, HAND)
    points[..., 1:, :] -= points[..., :1, :]
    flat = points.reshape(*points.shape[:-2], -1)
    return np.concatenate([flat, _turns(footprint_from_tcp)], axis=-1)


def _turns(footprint_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Headings of gripper poses: (..., 4, 4) -> (..., HEADING)."""
    fingers = footprint_from_tcp[..., :2, 1]  # the axis along which they move
    heading = np.arctan2(fingers[..., 1], fingers[..., 0])
    turns = np.concatenate([[np.cos(k * heading), np.sin(k * heading)] for k in (1, 2, 4)])
    return np.moveaxis(turns, 0, -1)


def _placed(pixels: NDArray[np.float64], row: int, count: int) -> NDArray[np.float32]:
    """Places (..., 2) in picture `row` of `count` of equal size -> in all of them, side by side."""
    if count > 1:
        within = inside_picture(pixels)[..., None]
        pixels = np.where(within, (pixels + np.array([row, 0])) / np.array([count, 1]), np.nan)
    return pixels.astype(np.float32)


def _own(tcp: NDArray[np.float64], changed: NDArray[np.int64], keyframes: int) -> list[NDArray[np.float64]]:
    """Keypoints (T, 4, 4) of an agent in one episode: at each change, NaN after it, and at the end."""
    steps = np.arange(len(tcp))
    columns = []
    for key in range(keyframes):
        column = np.full_like(tcp, np.nan)
        if key < len(changed):
            column[steps <= changed[key]] = tcp[changed[key]]
        columns.append(column)
    return [*columns, np.broadcast_to(tcp[-1], tcp.shape)]


def _project(points: NDArray[np.float64], camera: CameraModel) -> NDArray[np.float64]:
    """World points (..., 3) -> (..., 2) from 0 to 1 over the picture; NaN behind the camera."""
    seen = apply(inverse(camera.world_from_camera), points) @ camera.intrinsics.T
    depth = np.where(seen[..., 2:] > 1e-3, seen[..., 2:], np.nan)
    return seen[..., :2] / depth / (camera.width_px, camera.height_px)
