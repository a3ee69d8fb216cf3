"""Where an arm will be when its gripper changes next, as demonstrations tell it: what eyes learn to see.

The keypoints of a stream are, for each of its agents, the TCP at the changes of its own gripper, in their
order, and at the end of the episode; then the TCPs of all other agents now. No pose of an object is used:
all follows from stored joints and commands, and a camera whose place is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.policy.views import Stream
from rf_exp.robots.panda import tcp_pose
from rf_exp.tasks.base import CameraSpec
from rf_exp.transforms import inverse, planar
from rf_exp.types import ARM_JOINTS

if TYPE_CHECKING:
    from rf_exp.store import Store

HEADING = (
    6  # cosine and sine of one, two and four times the heading of the fingers; 4: a cube is alike all round
)


@dataclass(frozen=True)
class Keypoints:
    """M keypoints in each of T frames of a stream. NaN where one is not there, or is past."""

    pixels: NDArray[np.float32]  # (T, M, 2) x to the right and y down, from 0 to 1 over the picture
    points: NDArray[np.float32]  # (T, M, 3) m, in the base frame of the stream's first agent
    headings: NDArray[np.float32]  # (T, M, HEADING)


def keypoints(store: "Store", stream: Stream, own_keys: int, kept: NDArray[np.bool_] | slice) -> Keypoints:
    """The keypoints of the kept frames of a store.

    Raises ArgumentError where the store does not say where arms and cameras stand, and for a moving camera.
    """
    scene = _scene(store)
    bases = [planar(r["x_m"], r["y_m"], float(np.deg2rad(r["yaw_deg"]))) for r in scene["robots"]]
    camera = CameraSpec(**scene["cameras"][stream.camera])
    if camera.mount != "world":
        raise ArgumentError(f"camera {stream.camera!r} rides on a hand; heat maps need one that stands still")
    others = [agent for agent in range(1, store.agents + 1) if agent not in stream.agents]
    found = []
    episodes = zip(_episodes(store, store.qpos), _episodes(store, store.action), strict=True)
    for qpos, action in episodes:
        tcp = np.stack([bases[k] @ tcp_pose(qpos[:, k]) for k in range(store.agents)], axis=1)  # (T, N, 4, 4)
        columns = []
        for agent in stream.agents:
            columns += _own(tcp[:, agent - 1], action[:, agent - 1, ARM_JOINTS], own_keys)
        columns += [tcp[:, agent - 1] for agent in others]
        found.append(np.stack(columns, axis=1))
    world = np.concatenate(found)[kept]  # (T, M, 4, 4)
    local = inverse(bases[stream.agents[0] - 1]) @ world
    heading = np.arctan2(local[..., 1, 1], local[..., 0, 1])  # of the axis along which fingers move
    turns = np.concatenate([[np.cos(k * heading), np.sin(k * heading)] for k in (1, 2, 4)])
    pixels = _project(world[..., :3, 3], camera, store.attrs["width"] / store.attrs["height"])
    return Keypoints(
        pixels.astype(np.float32),
        local[..., :3, 3].astype(np.float32),
        np.moveaxis(turns, 0, -1).astype(np.float32),
    )


def _own(
    tcp: NDArray[np.floating], gripper: NDArray[np.floating], own_keys: int
) -> list[NDArray[np.floating]]:
    """The keypoints (T, 4, 4) of an agent of one episode: at each change, until then, and at the end."""
    steps = np.arange(len(tcp))
    changes = np.flatnonzero(np.diff(gripper > 0, prepend=True))
    columns = []
    for key in range(own_keys):
        column = np.full_like(tcp, np.nan)
        if key < len(changes):
            column[steps <= changes[key]] = tcp[changes[key]]
        columns.append(column)
    return [*columns, np.broadcast_to(tcp[-1], tcp.shape)]


def _project(points: NDArray[np.floating], camera: CameraSpec, aspect: float) -> NDArray[np.floating]:
    """World points (..., 3) -> (..., 2) from 0 to 1 over a picture of width / height `aspect`; NaN behind."""
    camera_from_world = inverse(camera.world_from_camera)
    seen = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    depth = np.where(seen[..., 2:] > 1e-3, seen[..., 2:], np.nan)
    half = np.tan(np.deg2rad(camera.fov_deg) / 2) * np.array([aspect, 1.0])
    return 0.5 + 0.5 * seen[..., :2] / depth / half


def _scene(store: "Store") -> Mapping[str, Any]:
    try:
        return {name: store.identity["scene"][name] for name in ("robots", "cameras")}
    except KeyError as error:
        raise ArgumentError(
            f"{store.path} does not say where its arms and cameras stand; generate it again"
        ) from error


def _episodes(store: "Store", values: NDArray) -> list[NDArray]:
    return np.split(values[: store.steps], store.episode_ends[:-1])
