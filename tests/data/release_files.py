"""Writers of third-party demonstration files: raw trajectories, Zarr 2, and Policy-Lightning's HDF5.

They hold artificial episodes, and use no code of rf_exp's exporters.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numcodecs
import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.robots import DEFAULT
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import planar, position_and_quaternion

HEIGHT, WIDTH, FOV_DEG = 16, 24, 60.0
BASES = (planar(0.0, -0.75, np.pi / 2), planar(0.0, 0.75, -np.pi / 2))
CAMERAS = {
    "head_camera_global": CameraSpec((1.1, 0.0, 0.9), (0.0, 0.0, 0.26), FOV_DEG),
    "head_camera_agent0": CameraSpec(
        (0.6, -0.38, 0.5), (0.0, -0.2, 0.15), FOV_DEG, turn_deg=(0.0, 0.0, 10.0)
    ),
    "head_camera_agent1": CameraSpec((0.6, 0.38, 0.5), (0.0, 0.2, 0.15), FOV_DEG),
}
CAMERA_NAMES = {
    "head_camera_global": "global",
    "head_camera_agent0": "agent1",
    "head_camera_agent1": "agent2",
}


class SourceEpisode(NamedTuple):
    """An episode of T actions with T + 1 observations."""

    seed: int
    qpos: NDArray[np.float32]  # (T + 1, N, 9)
    qvel: NDArray[np.float32]
    action: NDArray[np.float32]  # (T, N, 8)
    barrier: NDArray[np.float32]  # (T + 1, 13)
    rgb: dict[str, NDArray[np.uint8]]  # (T + 1, H, W, 3)
    depth: dict[str, NDArray[np.int16]]  # (T + 1, H, W, 1)

    @property
    def steps(self) -> int:
        return len(self.action)


def source_episode(seed: int, steps: int = 6, agents: int = 2) -> SourceEpisode:
    """Arms that move around their rest posture and close their grippers half-way through the episode."""
    rng = np.random.default_rng(seed)
    joints = np.array(DEFAULT.rest_rad) + rng.normal(0, 0.05, (steps + 1, agents, 7)).cumsum(axis=0)
    gripper = np.where(np.arange(steps) < steps // 2, 1.0, -1.0)[:, None, None].repeat(agents, axis=1)
    fingers = np.full((steps + 1, agents, 2), 0.02)
    pose = np.array([0.1, 0.2, 0.03, 1.0, 0.0, 0.0, 0.0])
    names = CAMERAS if agents == 2 else ("head_camera",)
    size = steps + 1, HEIGHT, WIDTH
    return SourceEpisode(
        seed,
        np.concatenate([joints, fingers], axis=-1).astype(np.float32),
        rng.normal(size=(steps + 1, agents, 9)).astype(np.float32),
        np.concatenate([joints[1:], gripper], axis=-1).astype(np.float32),
        np.column_stack([np.tile(pose, (steps + 1, 1)), rng.normal(size=(steps + 1, 6))]).astype(np.float32),
        {name: rng.integers(0, 256, (*size, 3), np.uint8) for name in names},
        {name: rng.integers(0, 9999, (*size, 1)).astype(np.int16) for name in names},
    )


def write_raw(path: Path, episodes: Sequence[SourceEpisode], depth: bool = False, surplus: int = 0) -> Path:
    """Writes the .h5 of ManiSkill's RecordEpisode and the .json beside it.

    Each episode has `surplus` rows after its first success.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for number, episode in enumerate(episodes):
            group = file.create_group(f"traj_{number}")
            is_multi_arm = episode.action.shape[1] > 1
            for arm in range(episode.action.shape[1]):
                name = f"/panda-{arm}" if is_multi_arm else ""
                group[f"obs/agent{name}/qpos"] = episode.qpos[:, arm]
                group[f"obs/agent{name}/qvel"] = episode.qvel[:, arm]
                group[f"actions{name}"] = episode.action[:, arm].astype(
                    np.float64 if is_multi_arm else np.float32
                )
                root = [*position_and_quaternion(BASES[arm]), *[0.0] * 6]
                state = [np.tile(root, (episode.steps + 1, 1)), episode.qpos[:, arm], episode.qvel[:, arm]]
                articulation = f"panda-agent-{arm}" if is_multi_arm else "panda"
                group[f"env_states/articulations/{articulation}"] = np.column_stack(state).astype(np.float32)
            group["env_states/actors/barrier"] = episode.barrier
            group["env_states/actors/ground"] = episode.barrier
            for camera, frames in episode.rgb.items():
                compression = {"compression": "gzip", "chunks": (1, *frames.shape[1:])}
                group.create_dataset(f"obs/sensor_data/{camera}/rgb", data=frames, **compression)
                if depth:
                    group[f"obs/sensor_data/{camera}/depth"] = episode.depth[camera]
                for key, matrix in camera_parameters(camera).items():
                    rows = np.tile(matrix.astype(np.float32), (episode.steps + 1, 1, 1))
                    group[f"obs/sensor_param/{camera}/{key}"] = rows
            success = np.arange(episode.steps) >= episode.steps - 1 - surplus
            group["success"], group["terminated"], group["truncated"] = success, success, success & False
    metadata = [
        {
            "episode_id": number,
            "episode_seed": episode.seed,
            "control_mode": "pd_joint_pos",
            "elapsed_steps": episode.steps,
            "success": True,
        }
        for number, episode in enumerate(episodes)
    ]
    kwargs = {"control_mode": "pd_joint_pos", "obs_mode": "rgb"}
    info = {"env_id": "LiftBarrier-rf", "env_kwargs": kwargs, "max_episode_steps": 500}
    path.with_suffix(".json").write_text(json.dumps({"env_info": info, "episodes": metadata}))
    return path


def camera_parameters(camera: str) -> dict[str, NDArray[Any]]:
    """The camera parameters that ManiSkill records."""
    pose = CAMERAS.get(camera, CAMERAS["head_camera_global"]).world_from_camera
    focal = HEIGHT / 2 / np.tan(np.deg2rad(FOV_DEG) / 2)
    intrinsics = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    gl = pose @ np.diag([1, -1, -1, 1])
    return {"extrinsic_cv": np.linalg.inv(pose)[:3], "cam2world_gl": gl, "intrinsic_cv": intrinsics}


def stacked_actions(episodes: Sequence[SourceEpisode]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """The actions (T, N, 8) of all episodes, and the end (exclusive) of each."""
    return np.concatenate([episode.action for episode in episodes]), np.cumsum(
        [episode.steps for episode in episodes]
    )


def stacked_frames(episodes: Sequence[SourceEpisode], camera: str) -> NDArray[np.uint8]:
    """The pictures (T, 3, H, W) of all episodes, one before each action."""
    return np.moveaxis(np.concatenate([episode.rgb[camera][:-1] for episode in episodes]), -1, 1)


def write_arm_zarr(folder: Path, episodes: Sequence[SourceEpisode], arm: int) -> Path:
    """Writes the Zarr 2 of one arm, as in the release of RoboFactory."""
    actions, ends = stacked_actions(episodes)
    path = folder / f"LiftBarrier-rf_Agent{arm}_{len(episodes)}.zarr"
    columns = {name: actions[:, arm] for name in ("action", "state", "tcp_action")}
    return write_replay_buffer(
        path, columns, {"head_camera": stacked_frames(episodes, f"head_camera_agent{arm}")}, ends
    )


def write_joint_zarr(path: Path, episodes: Sequence[SourceEpisode]) -> Path:
    """Writes the Zarr 2 of a fork, with all arms."""
    actions, ends = stacked_actions(episodes)
    columns = {name: actions.reshape(len(actions), -1) for name in ("action", "state")}
    frames = {f"head_camera_{arm}": stacked_frames(episodes, f"head_camera_agent{arm}") for arm in range(2)}
    return write_replay_buffer(
        path, columns, frames | {"head_camera_global": stacked_frames(episodes, "head_camera_global")}, ends
    )


def write_replay_buffer(
    path: Path, columns: Mapping[str, Any], frames: Mapping[str, Any], ends: NDArray[np.int64]
) -> Path:
    """Writes a replay buffer of Diffusion Policy."""
    group = zarr.open_group(path, mode="w", zarr_format=2)
    arrays = {f"data/{name}": rows.astype(np.float32) for name, rows in columns.items()}
    arrays |= {**{f"data/{name}": rows for name, rows in frames.items()}, "meta/episode_ends": ends}
    for name, rows in arrays.items():
        blosc = numcodecs.Blosc("zstd", clevel=3, shuffle=1)
        group.create_array(name, data=rows, chunks=(100, *rows.shape[1:]), compressors=blosc)
    return path


def write_lightning(path: Path, episodes: Sequence[SourceEpisode], channels_first: bool = True) -> Path:
    """Writes Policy-Lightning's HDF5."""
    actions, ends = stacked_actions(episodes)
    compression = {"compression": "gzip", "compression_opts": 4}
    with h5py.File(path, "w") as file:
        for arm in range(2):
            file.create_dataset(f"action_{arm}", data=actions[:, arm], maxshape=(None, 8), **compression)
            frames = stacked_frames(episodes, f"head_camera_agent{arm}")
            frames = frames if channels_first else np.moveaxis(frames, 1, -1)
            file.create_dataset(
                f"head_cam_{arm}", data=frames, maxshape=(None, *frames.shape[1:]), **compression
            )
        file["pointcloud"] = np.zeros((len(actions), 512, 6), np.float32)
        file.create_dataset("episode_ends", data=ends, **compression)
    return path
