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
from rf_exp.data.release import commands, environment, own
from rf_exp.data.target import Advance, create, last, library
from rf_exp.robots import DEFAULT
from rf_exp.store import Store
from rf_exp.tasks import camera_name
from rf_exp.transforms import Matrix, inverse, position_and_quaternion
from rf_exp.types import FINGERS, Episode

PICTURES = ("gzip", "plain")  # both keep every pixel
TAGS = ("ManiSkill", "RoboFactory")
NAME = "trajectory"
CONTROL_MODE = "pd_joint_pos"  # absolute joint targets
SUCCESS = "success"  # the only condition in such a file
ROOT = 13  # numbers of a body's state: position, quaternion, velocities
STILL = np.zeros(6, np.float32)  # body velocities, which a store does not hold
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # y up and z backward, from y down and z forward


def held(pictures: str) -> str:
    return (
        f"`{NAME}.h5` and `{NAME}.json`, as ManiSkill's RecordEpisode writes them and the authors' release\n"
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
    with library("h5py").File(folder / f"{NAME}.h5", "w") as file:
        for index in range(len(store)):
            _write(file.create_group(f"traj_{index}"), store, store.episode(index), pictures == "gzip")
            advance()
    mode = {"control_mode": CONTROL_MODE}
    seen = {"obs_mode": "rgb" if store.cameras else "state_dict", **mode}
    told = {
        "env_info": {"env_id": name, "env_kwargs": seen, "max_episode_steps": max(steps)},
        "episodes": [
            {"episode_id": index, "episode_seed": seed, "reset_kwargs": {"seed": seed}, **mode}
            | {"elapsed_steps": count, SUCCESS: True}
            for index, (seed, count) in enumerate(zip(seeds, steps, strict=True))
        ],
        "source_type": "motionplanning",
        "source_desc": "demonstrations of rf_exp",
    }
    write_json(folder / f"{NAME}.json", told)


def _write(group: Any, store: Store, episode: Episode, compressed: bool) -> None:  # an h5py.Group
    kinds = ["panda" if model.kind == DEFAULT.kind else model.kind for model in store.models]
    arms = [""] if store.agents == 1 else [f"/{kind}-{agent}" for agent, kind in enumerate(kinds)]
    done = last(len(episode.qpos))
    values: dict[str, NDArray[Any]] = {"terminated": done, "truncated": np.zeros_like(done), SUCCESS: done}
    stands = _bases(store, episode)
    for agent, arm in enumerate(arms):
        joints, speeds = (own(store, agent, rows[:, agent], FINGERS) for rows in (episode.qpos, episode.qvel))
        values[f"actions{arm}"] = commands(store, agent, episode.action)
        if episode.executed is not None:
            values[f"executed{arm}"] = commands(store, agent, episode.executed)
        values[f"obs/agent{arm}/qpos"], values[f"obs/agent{arm}/qvel"] = _and_last(joints), _and_last(speeds)
        if stands:
            root = np.append(position_and_quaternion(stands[agent]), STILL).astype(np.float32)
            state = np.column_stack([np.tile(root, (len(joints), 1)), joints, speeds])
            called = kinds[agent] if store.agents == 1 else f"{kinds[agent]}-agent-{agent}"
            values[f"env_states/articulations/{called}"] = _and_last(state)
    for name, poses in episode.poses.items():
        moving = np.column_stack([poses, np.tile(STILL, (len(poses), 1))])
        values[f"env_states/actors/{name}"] = _and_last(moving)
    for camera, (intrinsics, world_from_camera) in _cameras(store, episode).items():
        where = f"obs/sensor_param/{camera_name(camera, store.agents)}"
        given = {
            "extrinsic_cv": inverse(world_from_camera)[:3],
            "cam2world_gl": world_from_camera @ GL_FROM_CV,
            "intrinsic_cv": intrinsics,
        }
        for name, matrix in given.items():
            values[f"{where}/{name}"] = np.tile(matrix.astype(np.float32), (len(done) + 1, 1, 1))
    seen: dict[tuple[str, str], NDArray[Any]]
    seen = {(camera, "rgb"): frames for camera, frames in episode.images.items()}
    for name, depth in episode.extras.items():
        what, _, camera = name.partition("_")
        if what == "depth":  # saturates at the largest int16
            seen[camera, what] = np.minimum(depth, np.iinfo(np.int16).max).astype(np.int16)[..., None]
    places = {each: f"obs/sensor_data/{camera_name(each[0], store.agents)}/{each[1]}" for each in seen}
    create(group, values)
    create(group, {places[each]: _and_last(frames) for each, frames in seen.items()}, compressed)


def _and_last(rows: NDArray[Any]) -> NDArray[Any]:
    """Observations with the last row repeated: a store holds none after the last action."""
    return np.concatenate([rows, rows[-1:]])


def _bases(store: Store, episode: Episode) -> list[Matrix]:
    """world_from_base (4, 4) of each arm; empty where unknown."""
    said = _calibration(episode)
    if said is not None:
        return [np.array(each) for each in said["world_from_base"]]
    return [np.array(each) for each in store.description.world_from_base] if store.description else []


def _cameras(store: Store, episode: Episode) -> dict[str, tuple[Matrix, Matrix]]:
    """Camera -> intrinsics (3, 3) px and world_from_camera (4, 4), for cameras fixed in the world."""
    models = store.description.camera_models if store.description else {}
    said = _calibration(episode) or {"cameras": {}}
    found = {}
    for camera, model in models.items():
        if "world_from_camera" not in model:
            continue
        intrinsics, pose = np.array(model["intrinsics"], float), np.array(model["world_from_camera"], float)
        if (own := said["cameras"].get(camera)) is not None:
            pose = np.array(own["parent_from_camera"], float)
            focal = store.attrs["height"] / 2 / np.tan(np.deg2rad(own["fov_deg"]) / 2)
            intrinsics[0, 0] = intrinsics[1, 1] = focal
        found[camera] = intrinsics, pose
    return found


def _calibration(episode: Episode) -> Any:
    """Calibration of this episode where it differs from the store's, else None."""
    return episode.certificate.get("calibration")
