"""Export as trajectories of ManiSkill's RecordEpisode: an HDF5 file, and a JSON file of the same name.

    traj_<i>/obs/agent/panda-<k>/qpos, qvel (T+1, 9) f32   measured before each action, and after the last
    traj_<i>/obs/sensor_data/<camera>/rgb (T+1, H, W, 3) u8, depth (T+1, H, W, 1) i16 mm
    traj_<i>/obs/sensor_param/<camera>/extrinsic_cv (T+1, 3, 4)    camera_from_world, axes of OpenCV
                                       cam2world_gl (T+1, 4, 4)    world_from_camera, axes of OpenGL
                                       intrinsic_cv (T+1, 3, 3)    px
    traj_<i>/actions/panda-<k> (T, 8)                      joint targets in rad, gripper from -1 to 1
    traj_<i>/terminated, truncated, success (T,)           after each action
    traj_<i>/env_states/actors/<name> (T+1, 13)            position, quaternion w, x, y, z, velocities
    traj_<i>/env_states/articulations/<name> (T+1, 13 + 2 dof)   the same for the root, then qpos and qvel

With a single arm, `actions` and `obs/agent` hold its arrays directly, without the level `panda-<k>`.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.artifacts import write_json
from rf_exp.data.formats import Advance, create_datasets, import_library, success_flags
from rf_exp.data.release import agent_commands, arm_columns, environment
from rf_exp.robots import DEFAULT
from rf_exp.store import Store
from rf_exp.tasks import camera_to_release
from rf_exp.transforms import Matrix, inverse, position_and_quaternion
from rf_exp.types import FINGERS, Episode

PICTURES = ("gzip", "plain")  # both keep every pixel
TAGS = ("ManiSkill", "RoboFactory")
STEM = "trajectory"
CONTROL_MODE = "pd_joint_pos"  # absolute joint targets
SUCCESS = "success"  # the only condition in such a file
ROOT_SIZE = 13  # numbers of a body's state: position, quaternion, velocities
ZERO_VELOCITY = np.zeros(6, np.float32)  # body velocities, which a store does not hold
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # y up and z backward, from y down and z forward


def describe(pictures: str) -> str:
    return (
        f"`{STEM}.h5` and `{STEM}.json`, as ManiSkill's RecordEpisode writes them and the authors' release\n"
        "reads them below `demos/<Task>-rf/motionplanning`: a group `traj_<i>` an episode, with `actions`\n"
        "(joint targets in rad and a gripper command, as they were meant), `obs/agent`, `obs/sensor_data`\n"
        f"(pictures as they were, {pictures}), `obs/sensor_param`, `env_states` and `success`. Where\n"
        "demonstrations are disturbed, `executed` is what the arms were told. Observations have a row more\n"
        "than actions: the last one is the one before it once more. Velocities of objects are not known,\n"
        "and zero."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance) -> None:
    name = environment(store.attrs["task"])
    seeds, steps = store.seeds.tolist(), np.diff(store.episode_ends, prepend=0).tolist()
    with import_library("h5py").File(folder / f"{STEM}.h5", "w") as file:
        for index in range(len(store)):
            _write(file.create_group(f"traj_{index}"), store, store.episode(index), pictures == "gzip")
            advance()
    mode = {"control_mode": CONTROL_MODE}
    env_kwargs = {"obs_mode": "rgb" if store.cameras else "state_dict", **mode}
    metadata = {
        "env_info": {"env_id": name, "env_kwargs": env_kwargs, "max_episode_steps": max(steps)},
        "episodes": [
            {"episode_id": index, "episode_seed": seed, "reset_kwargs": {"seed": seed}, **mode}
            | {"elapsed_steps": count, SUCCESS: True}
            for index, (seed, count) in enumerate(zip(seeds, steps, strict=True))
        ],
        "source_type": "motionplanning",
        "source_desc": "demonstrations of rf_exp",
    }
    write_json(folder / f"{STEM}.json", metadata)


def _write(group: Any, store: Store, episode: Episode, compressed: bool) -> None:  # an h5py.Group
    robot_kinds = ["panda" if model.kind == DEFAULT.kind else model.kind for model in store.models]
    arms = [""] if store.agents == 1 else [f"/{kind}-{agent}" for agent, kind in enumerate(robot_kinds)]
    success = success_flags(len(episode.qpos))
    values: dict[str, NDArray[Any]] = {
        "terminated": success,
        "truncated": np.zeros_like(success),
        SUCCESS: success,
    }
    base_poses = _base_poses(store, episode)
    for agent, arm in enumerate(arms):
        joints, speeds = (
            arm_columns(store, agent, rows[:, agent], FINGERS) for rows in (episode.qpos, episode.qvel)
        )
        values[f"actions{arm}"] = agent_commands(store, agent, episode.action)
        if episode.executed is not None:
            values[f"executed{arm}"] = agent_commands(store, agent, episode.executed)
        values[f"obs/agent{arm}/qpos"], values[f"obs/agent{arm}/qvel"] = (
            _repeat_last(joints),
            _repeat_last(speeds),
        )
        if base_poses:
            root = np.append(position_and_quaternion(base_poses[agent]), ZERO_VELOCITY).astype(np.float32)
            state = np.column_stack([np.tile(root, (len(joints), 1)), joints, speeds])
            articulation = robot_kinds[agent] if store.agents == 1 else f"{robot_kinds[agent]}-agent-{agent}"
            values[f"env_states/articulations/{articulation}"] = _repeat_last(state)
    for name, poses in episode.poses.items():
        states = np.column_stack([poses, np.tile(ZERO_VELOCITY, (len(poses), 1))])
        values[f"env_states/actors/{name}"] = _repeat_last(states)
    for camera, (intrinsics, world_from_camera) in _cameras(store, episode).items():
        group_path = f"obs/sensor_param/{camera_to_release(camera, store.agents)}"
        matrices = {
            "extrinsic_cv": inverse(world_from_camera)[:3],
            "cam2world_gl": world_from_camera @ GL_FROM_CV,
            "intrinsic_cv": intrinsics,
        }
        for name, matrix in matrices.items():
            values[f"{group_path}/{name}"] = np.tile(matrix.astype(np.float32), (len(success) + 1, 1, 1))
    pictures: dict[tuple[str, str], NDArray[Any]]
    pictures = {(camera, "rgb"): frames for camera, frames in episode.images.items()}
    for name, depth in episode.extras.items():
        modality, _, camera = name.partition("_")
        if modality == "depth":  # saturates at the largest int16
            pictures[camera, modality] = np.minimum(depth, np.iinfo(np.int16).max).astype(np.int16)[..., None]
    paths = {key: f"obs/sensor_data/{camera_to_release(key[0], store.agents)}/{key[1]}" for key in pictures}
    create_datasets(group, values)
    create_datasets(group, {paths[key]: _repeat_last(frames) for key, frames in pictures.items()}, compressed)


def _repeat_last(rows: NDArray[Any]) -> NDArray[Any]:
    """Observations with the last row repeated: a store holds none after the last action."""
    return np.concatenate([rows, rows[-1:]])


def _base_poses(store: Store, episode: Episode) -> list[Matrix]:
    """world_from_base (4, 4) of each arm; empty where unknown."""
    calibration = _calibration(episode)
    if calibration is not None:
        return [np.array(pose) for pose in calibration["world_from_base"]]
    return [np.array(pose) for pose in store.description.world_from_base] if store.description else []


def _cameras(store: Store, episode: Episode) -> dict[str, tuple[Matrix, Matrix]]:
    """Camera -> intrinsics (3, 3) px and world_from_camera (4, 4), for cameras fixed in the world."""
    models = store.description.camera_models if store.description else {}
    calibration = _calibration(episode) or {"cameras": {}}
    cameras = {}
    for camera, model in models.items():
        if "world_from_camera" not in model:
            continue
        intrinsics, pose = np.array(model["intrinsics"], float), np.array(model["world_from_camera"], float)
        if (camera_calibration := calibration["cameras"].get(camera)) is not None:
            pose = np.array(camera_calibration["parent_from_camera"], float)
            focal = store.attrs["height"] / 2 / np.tan(np.deg2rad(camera_calibration["fov_deg"]) / 2)
            intrinsics[0, 0] = intrinsics[1, 1] = focal
        cameras[camera] = intrinsics, pose
    return cameras


def _calibration(episode: Episode) -> Any:
    """Calibration of this episode where it differs from the store's, else None."""
    return episode.certificate.get("calibration")
