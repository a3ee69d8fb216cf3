"""Imports of third-party demonstrations: stores with their values, and a list of missing data."""

import json
import pickle
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import zarr

from rf_exp.store import Store, problems
from rf_exp.types import Episode
from tests.data.release_files import (
    BASES,
    CAMERA_NAMES,
    CAMERAS,
    FOV_DEG,
    HEIGHT,
    WIDTH,
    SourceEpisode,
    source_episode,
    stacked_actions,
    stacked_frames,
    write_arm_zarr,
    write_joint_zarr,
    write_lightning,
    write_raw,
    write_replay_buffer,
)

EPISODES = [source_episode(seed, 5 + seed % 3) for seed in (7, 3, 12)]
Command = Callable[..., Any]
pytestmark = pytest.mark.slow


@pytest.fixture
def command(data_command: Command) -> Command:
    """`python -m rf_exp.data import` in this process: exit code, standard output, standard error."""
    return partial(data_command, "import")


def assert_equal_buffer(store: Store, episodes: Sequence[SourceEpisode]) -> None:
    """Compares all data of a replay buffer: commands and pictures."""
    assert len(store) == len(episodes)
    for index, source in enumerate(episodes):
        episode = store.episode(index)
        np.testing.assert_array_equal(episode.action, source.action, strict=True)
        for camera in store.cameras:
            name = next(name for name, own_name in CAMERA_NAMES.items() if own_name == camera)
            np.testing.assert_array_equal(episode.images[camera], source.rgb[name][:-1], strict=True)
        assert problems(store, index) == []


def assert_equal_trajectory(episode: Episode, source: SourceEpisode, steps: int | None = None) -> None:
    """Compares all data of a raw trajectory, in its first rows."""
    steps = source.steps if steps is None else steps
    assert episode.seed == source.seed
    np.testing.assert_array_equal(episode.qpos, source.qpos[:steps], strict=True)
    np.testing.assert_array_equal(episode.qvel, source.qvel[:steps], strict=True)
    np.testing.assert_array_equal(episode.action, source.action[:steps], strict=True)
    np.testing.assert_array_equal(episode.poses["barrier"], source.barrier[:steps, :7], strict=True)
    for name, camera in CAMERA_NAMES.items():
        np.testing.assert_array_equal(episode.images[camera], source.rgb[name][:steps], strict=True)


# Raw trajectories


def test_raw_trajectories_are_imported_completely(tmp_path: Path, command: Command) -> None:
    path, to = write_raw(tmp_path / "LiftBarrier-rf/x.h5", EPISODES, depth=True), tmp_path / "s.zarr"
    code, output, _ = command(path, to, "--dry-run")
    assert (
        code == 0 and "would hold 3 episodes of lift_barrier, 16 steps, 2 arms" in output and not to.exists()
    )
    assert command(path, to)[0] == 0
    store = Store.open(to)
    assert store.cameras == ("global", "agent1", "agent2") and store.objects == ("barrier",)
    for index, source in enumerate(EPISODES):
        episode = store.episode(index)
        assert_equal_trajectory(episode, source)
        for name, camera in CAMERA_NAMES.items():
            depth = episode.extras[f"depth_{camera}"]
            np.testing.assert_array_equal(
                depth, source.depth[name][:-1, ..., 0].astype(np.uint16), strict=True
            )
        assert episode.judged is not None and episode.judged.holds[:, 0].tolist() == [False] * (
            source.steps - 1
        ) + [True]
        assert episode.certificate["imported"] == f"traj_{index}" and problems(store, index) == []
        half = source.steps // 2
        assert episode.subgoal is not None and episode.subgoal[:, 0].tolist() == [0] * half + [1] * (
            source.steps - half
        )
    card = to.with_suffix(".md").read_text()
    assert "trajectories of ManiSkill's RecordEpisode" in card and "license: unknown" in card
    assert "| subgoals |" in card and "| calibration |" not in card and "RoboBrain proposes" not in card


def test_poses_of_arms_and_cameras_are_imported(tmp_path: Path, command: Command) -> None:
    path, to = write_raw(tmp_path / "x.h5", EPISODES), tmp_path / "s.zarr"
    assert command(path, to)[0] == 0
    store = Store.open(to)
    assert store.description is not None
    np.testing.assert_allclose(store.description.world_from_base, BASES, atol=1e-6)
    scene = store.identity["scene"]
    for name, camera in CAMERA_NAMES.items():
        model = store.description.camera_models[camera]
        np.testing.assert_allclose(model["world_from_camera"], CAMERAS[name].world_from_camera, atol=1e-6)
        rebuilt = type(CAMERAS[name])(**scene["cameras"][camera])
        np.testing.assert_allclose(rebuilt.world_from_camera, CAMERAS[name].world_from_camera, atol=1e-6)
        assert abs(rebuilt.fov_deg - FOV_DEG) < 1e-4
    assert [round(each["yaw_deg"], 3) for each in scene["robots"]] == [90, -90]


def test_a_different_camera_pose_in_one_trajectory_is_in_its_certificate(
    tmp_path: Path, command: Command
) -> None:
    path, to = write_raw(tmp_path / "x.h5", EPISODES[:2]), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        params: Any = file["traj_1/obs/sensor_param/head_camera_agent0"]
        params["extrinsic_cv"][:, 0, 3] += 0.1
        params["cam2world_gl"][:, :3, 3] -= 0.1 * params["extrinsic_cv"][0, 0, :3]
    assert command(path, to)[0] == 0
    certificates = Store.open(to).certificates
    assert "calibration" not in certificates[0]
    parent_from_camera = np.array(certificates[1]["calibration"]["cameras"]["agent1"]["parent_from_camera"])
    assert abs(np.linalg.norm(parent_from_camera[:3, 3] - CAMERAS["head_camera_agent0"].eye_m) - 0.1) < 1e-5


def test_rows_after_the_first_success_and_failed_trajectories_are_left_out(
    tmp_path: Path, command: Command
) -> None:
    path, to = write_raw(tmp_path / "x.h5", EPISODES, surplus=2), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        file["traj_1/success"][:] = False  # pyright: ignore[reportIndexIssue]
    code, output, _ = command(path, to)
    assert code == 0 and "1 of 3 trajectories were left out: traj_1 (it never succeeds)" in output
    assert "4 rows after the first success were left out" in output
    store = Store.open(to)
    for index, source in enumerate((EPISODES[0], EPISODES[2])):
        assert_equal_trajectory(store.episode(index), source, source.steps - 2)
    assert "4 rows after the first success" in to.with_suffix(".md").read_text()


def test_a_trajectory_ends_before_its_missing_frames(tmp_path: Path, command: Command) -> None:
    path, to = write_raw(tmp_path / "x.h5", EPISODES, surplus=2), tmp_path / "s.zarr"
    shorten(path, "traj_0/obs/sensor_data/head_camera_agent1/rgb", EPISODES[0].steps - 1)
    shorten(path, "traj_2/obs/sensor_data/head_camera_agent1/rgb", 1)
    code, output, _ = command(path, to)
    assert code == 0 and f"rgb has {EPISODES[0].steps - 1} rows, {EPISODES[0].steps} expected" in output
    assert "traj_2 (it never succeeds)" in output  # within the available rows
    store = Store.open(to)
    assert_equal_trajectory(store.episode(0), EPISODES[0], EPISODES[0].steps - 2)


def shorten(path: Path, name: str, rows: int) -> None:
    with h5py.File(path, "r+") as file:
        values: Any = file[name]
        values = values[:rows]
        del file[name]
        file[name] = values


def test_commands_beyond_joint_limits_are_clipped(tmp_path: Path, command: Command) -> None:
    source = source_episode(5)
    source.action[2, 0, 3] = 0.4  # the fourth joint goes up to -0.07
    path, to = write_raw(tmp_path / "x.h5", [source, source_episode(6)]), tmp_path / "s.zarr"
    code, output, _ = command(path, to)
    assert code == 0 and "commands of 1 episodes are up to 0.47 beyond the limits" in output
    episode = Store.open(to).episode(0)
    assert abs(episode.action[2, 0, 3] + 0.0698) < 1e-6
    np.testing.assert_array_equal(episode.executed, source.action, strict=True)


def test_a_single_arm_is_imported(tmp_path: Path, command: Command) -> None:
    source, to = source_episode(4, agents=1), tmp_path / "s.zarr"
    assert command(write_raw(tmp_path / "x.h5", [source]), to)[0] == 0
    episode = Store.open(to).episode(0)
    np.testing.assert_array_equal(episode.qpos, source.qpos[:-1], strict=True)
    np.testing.assert_array_equal(episode.images["agent1"], source.rgb["head_camera"][:-1], strict=True)


def test_missing_data_of_a_raw_file_is_replaced_and_listed(tmp_path: Path, command: Command) -> None:
    """Joints come from the observations, else from the state of the simulator, else from the commands."""
    path = write_raw(tmp_path / "x.h5", EPISODES[:1])
    steps = EPISODES[0].steps

    def without(name: str) -> Store:
        with h5py.File(path, "r+") as file:
            del file["traj_0"][name]  # pyright: ignore[reportIndexIssue]
        to = tmp_path / f"{name.replace('/', '-')}.zarr"
        assert command(path, to, "--task", "lift_barrier")[0] == 0
        return Store.open(to)

    store = without("obs/agent")
    np.testing.assert_array_equal(store.qpos, EPISODES[0].qpos[:steps], strict=True)
    store = without("obs/sensor_param")
    assert "calibration" in store.identity["imported"]["missing"] and store.identity["scene"]["cameras"] == {}
    store = without("env_states")
    missing = store.identity["imported"]["missing"]
    assert {"poses", "measured joints", "velocities"} <= missing.keys() and "scene" not in store.identity
    np.testing.assert_array_equal(store.qpos[..., :7], EPISODES[0].action[..., :7], strict=True)
    assert store.qpos[0, 0, 7] == np.float32(0.04) and store.qpos[-1, 0, 7] == 0
    path.with_suffix(".json").unlink()
    store = without("success")
    assert {"success", "seeds"} <= store.identity["imported"]["missing"].keys() and store.description is None
    assert store.seeds.tolist() == [0]


# Replay buffers


def test_the_zarr_files_of_all_arms_become_one_store(tmp_path: Path, command: Command) -> None:
    for arm in (0, 1):
        write_arm_zarr(tmp_path / "zarr_data", EPISODES, arm)
    assert command(tmp_path / "zarr_data", tmp_path / "s.zarr")[0] == 0
    arms = sorted((tmp_path / "zarr_data").iterdir())
    assert command(*arms, tmp_path / "t.zarr")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    assert (store.attrs["task"], store.cameras, store.agents) == ("lift_barrier", ("agent1", "agent2"), 2)
    assert_equal_buffer(store, EPISODES)
    assert store.digest() == Store.open(tmp_path / "t.zarr").digest()
    missing = store.identity["imported"]["missing"]
    assert {"poses", "calibration", "measured joints", "success", "seeds"} <= missing.keys()
    assert "policy=paper does without" in (tmp_path / "s.md").read_text()


def test_the_zarr_file_of_one_arm_becomes_a_store_of_one_arm(tmp_path: Path, command: Command) -> None:
    path = write_arm_zarr(tmp_path, EPISODES, 1)
    assert command(path, tmp_path / "s.zarr")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    actions, _ = stacked_actions(EPISODES)
    np.testing.assert_array_equal(store.action, actions[:, 1:], strict=True)
    np.testing.assert_array_equal(
        store.images["agent1"][:], np.moveaxis(stacked_frames(EPISODES, "head_camera_agent1"), 1, -1)
    )


def test_a_zarr_file_of_all_arms_becomes_a_store(tmp_path: Path, command: Command) -> None:
    path = write_joint_zarr(tmp_path / "joint.zarr", EPISODES)
    code, _, error = command(path, tmp_path / "s.zarr")
    assert code == 2 and "does not say of which task it is; say so, as in --task lift_barrier" in error
    assert command(path, tmp_path / "s.zarr", "--task", "lift_barrier")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    assert store.cameras == ("global", "agent1", "agent2")
    assert_equal_buffer(store, EPISODES)


def test_measured_joints_of_a_replay_buffer_are_imported(tmp_path: Path, command: Command) -> None:
    actions, ends = stacked_actions(EPISODES)
    qpos = np.concatenate([source.qpos[:-1] for source in EPISODES])
    frames = {"head_camera_global": np.moveaxis(stacked_frames(EPISODES, "head_camera_global"), 1, -1)}
    columns = {"action": actions.reshape(len(actions), -1), "state": qpos.reshape(len(qpos), -1)}
    path = write_replay_buffer(tmp_path / "x.zarr", columns, frames, ends)
    assert command(path, tmp_path / "s.zarr", "--task", "lift_barrier")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    np.testing.assert_array_equal(store.qpos, qpos, strict=True)
    assert_equal_buffer(store, EPISODES)


@pytest.mark.parametrize("channels_first", [True, False])
def test_policy_lightning_files_with_channels_first_or_last_are_imported(
    tmp_path: Path, command: Command, channels_first: bool
) -> None:
    path = write_lightning(tmp_path / "lift.h5", EPISODES, channels_first)
    code, output, _ = command(path, tmp_path / "s.zarr", "--task", "lift_barrier")
    assert code == 0 and "pointcloud was left out" in output
    assert_equal_buffer(Store.open(tmp_path / "s.zarr"), EPISODES)


# Errors


def test_an_interrupted_import_is_resumed(tmp_path: Path, command: Command) -> None:
    path, to = write_raw(tmp_path / "x.h5", EPISODES), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        frames: Any = file["traj_1/obs/sensor_data/head_camera_agent0/rgb"]
        offset, size = frames.id.get_chunk_info(0).byte_offset, frames.id.get_chunk_info(0).size
    content = path.read_bytes()
    path.write_bytes(content[:offset] + bytes(size) + content[offset + size :])
    code, _, error = command(path, to)
    assert code == 1 and "x.h5 cannot be imported: /traj_1/obs/sensor_data/head_camera_agent0/rgb" in error
    assert Store.open(to).seeds.tolist() == [7]
    path.write_bytes(content)
    assert "1 episodes are there, and nothing was written" in command(path, to, "--dry-run")[1]
    assert command(path, to)[0] == 0 and command(path, to)[0] == 0
    store = Store.open(to)
    for index, source in enumerate(EPISODES):
        assert_equal_trajectory(store.episode(index), source)
    code, _, error = command(write_raw(tmp_path / "y.h5", EPISODES[:2]), to)
    assert code == 1 and "was made from another configuration" in error and "imported.told" in error


def write_pickles(folder: Path) -> Path:
    path = folder / "pkl_data/LiftBarrier-rf_Agent0"
    (path / "episode0").mkdir(parents=True)
    (path / "episode0/0.pkl").write_bytes(pickle.dumps({"pointcloud": None}))
    return path


def test_pickles_are_refused_by_name(tmp_path: Path, command: Command) -> None:
    folder = write_pickles(tmp_path)
    for path in (folder, folder / "episode0/0.pkl", tmp_path / "pkl_data"):
        code, _, error = command(path, tmp_path / "s.zarr")
        assert code == 2 and "none is ever loaded" in error and "motionplanning/<stamp>.h5" in error
    assert not (tmp_path / "s.zarr").exists()


def valid_source(tmp_path: Path) -> Path:
    return write_raw(tmp_path / "x.h5", EPISODES[:1])


def changed_json(tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    path = valid_source(tmp_path)
    content = json.loads(path.with_suffix(".json").read_text())
    change(content)
    path.with_suffix(".json").write_text(json.dumps(content))
    return path


def other_hdf5(tmp_path: Path, name: str, value: Any) -> Path:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file[name] = value
    return path


def missing_frames(tmp_path: Path, rows: int) -> Path:
    """Frames that are declared but missing."""
    path = valid_source(tmp_path)
    with h5py.File(path, "r+") as file:
        name = "traj_0/obs/sensor_data/head_camera_agent0/rgb"
        del file[name]
        file.create_dataset(name, (rows, HEIGHT, WIDTH, 3), np.uint8, chunks=(1, HEIGHT, WIDTH, 3))
    return path


def linked_file(tmp_path: Path) -> Path:
    path = valid_source(tmp_path)
    path.rename(target := tmp_path / "elsewhere.h5")
    with h5py.File(path, "w") as file:
        file["traj_0"] = h5py.ExternalLink(str(target), "/traj_0")
    return path


def mismatched_arms(tmp_path: Path) -> Path:
    write_arm_zarr(tmp_path / "z", EPISODES, 0)
    shorter = write_arm_zarr(tmp_path, EPISODES[::-1], 1)
    shorter.rename(tmp_path / "z" / shorter.name)
    return tmp_path / "z"


def missing_chunk(tmp_path: Path) -> Path:
    path = write_arm_zarr(tmp_path, EPISODES, 0)
    (path / "data/head_camera/0.0.0.0").unlink()
    return path


def pickled_objects(tmp_path: Path) -> Path:
    path = write_arm_zarr(tmp_path, EPISODES, 0)
    file = path / "data/action/.zarray"
    content = json.loads(file.read_text())
    file.write_text(json.dumps({**content, "dtype": "|O", "filters": [{"id": "pickle", "protocol": 5}]}))
    return path


def two_data_sets(tmp_path: Path) -> Path:
    for count in (1, 2):
        write_arm_zarr(tmp_path / "z", EPISODES[:count], 0)
    return tmp_path / "z"


def other_robot(tmp_path: Path) -> Path:
    return write_replay_buffer(tmp_path / "pusht.zarr", {"action": np.zeros((9, 2))}, {}, np.array([9]))


REFUSED: dict[str, tuple[Callable[[Path], Path], int, str]] = {
    "nothing": (lambda folder: folder / "no.h5", 2, "there is nothing at"),
    "another control mode": (
        lambda folder: changed_json(
            folder, lambda content: content["episodes"][0].update(control_mode="pd_ee_pose")
        ),
        1,
        "its control mode is 'pd_ee_pose'; expected pd_joint_pos",
    ),
    "another rate": (
        lambda folder: changed_json(
            folder, lambda content: content["env_info"]["env_kwargs"].update(sim_config={"control_freq": 50})
        ),
        1,
        "its control rate is 50 Hz; a store is of 20",
    ),
    "JSON of two": (
        lambda folder: changed_json(
            folder, lambda content: content["episodes"].append(content["episodes"][0])
        ),
        1,
        "has two episodes 0",
    ),
    "another HDF5": (
        lambda folder: other_hdf5(folder, "data/demo_0/x", 1),
        2,
        "an HDF5 file with data in it; possible",
    ),
    "frames that are not there": (
        lambda folder: missing_frames(folder, 9),
        1,
        "of which parts are not in the file",
    ),
    "a huge array": (lambda folder: missing_frames(folder, 10**9), 1, "declares 1000000000 rows"),
    "a link": (linked_file, 1, "/traj_0 is a link to elsewhere"),
    "arms of two sets": (mismatched_arms, 1, "these are not arms of one data set"),
    "a lost file": (missing_chunk, 1, "the file data/head_camera/0.0.0.0 is missing"),
    "objects": (pickled_objects, 1, "objects may be pickles, which are never loaded"),
    "several sets": (two_data_sets, 2, "holds several data sets"),
    "another robot": (other_robot, 1, "data/action has 2 columns; expected 8 for each arm"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_invalid_sources_are_refused_before_anything_is_written(
    tmp_path: Path, command: Command, kind: str
) -> None:
    write_source, code, message = REFUSED[kind]
    path = write_source(tmp_path)
    exit_code, _, error = command(path, tmp_path / "new" / "s.zarr", "--task", "lift_barrier")
    assert (exit_code, message in error) == (code, True), error
    assert not (tmp_path / "new").exists() and "damaged" not in error


def test_joint_targets_in_degrees_are_refused(tmp_path: Path, command: Command) -> None:
    source = source_episode(1)
    source.action[..., :7] *= 180 / np.pi
    code, _, error = command(write_raw(tmp_path / "x.h5", [source]), tmp_path / "s.zarr")
    assert code == 1 and "expected absolute joint targets in rad" in error


def test_a_store_is_not_imported(tmp_path: Path, command: Command) -> None:
    assert command(valid_source(tmp_path), tmp_path / "s.zarr")[0] == 0
    code, _, error = command(tmp_path / "s.zarr", tmp_path / "t.zarr")
    assert code == 2 and "is a store of rf_exp already" in error


def test_other_files_are_not_overwritten(tmp_path: Path, command: Command) -> None:
    (existing := tmp_path / "there").mkdir()
    (existing / "mine.txt").write_text("mine")
    code, _, error = command(valid_source(tmp_path), existing, "--dry-run")
    assert code == 1 and "it is no store of rf_exp" in error
    code, _, error = command(tmp_path / "x.h5", existing)
    assert code == 1 and "it is no store of rf_exp" in error and (existing / "mine.txt").read_text() == "mine"


def test_opening_a_third_party_zarr_file_names_the_import_command(tmp_path: Path) -> None:
    path = write_arm_zarr(tmp_path, EPISODES, 0)
    with pytest.raises(Exception, match=r"nothing is wrong with it.*python -m rf_exp\.data import .* NEW"):
        Store.open(path)
    assert zarr.open_group(path, mode="r")["data/action"].shape[0] == 16  # pyright: ignore
