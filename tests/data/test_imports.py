"""Demonstrations of others, by the layout of their files, become stores that say what is missing."""

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
    CAMERAS,
    FOV_DEG,
    HEIGHT,
    OURS,
    WIDTH,
    Made,
    buffer,
    lightning,
    made,
    raw,
    seen,
    told,
    zarr_arm,
    zarr_joint,
)

EPISODES = [made(seed, 5 + seed % 3) for seed in (7, 3, 12)]
Command = Callable[..., Any]
pytestmark = pytest.mark.slow


@pytest.fixture
def command(data_command: Command) -> Command:
    """`python -m rf_exp.data import` in this process: exit code, standard output, standard error."""
    return partial(data_command, "import")


def assert_told(store: Store, episodes: Sequence[Made]) -> None:
    """All that a replay buffer holds: commands and pictures."""
    assert len(store) == len(episodes)
    for index, one in enumerate(episodes):
        got = store.episode(index)
        np.testing.assert_array_equal(got.action, one.action, strict=True)
        for camera in store.cameras:
            name = next(name for name, ours in OURS.items() if ours == camera)
            np.testing.assert_array_equal(got.images[camera], one.rgb[name][:-1], strict=True)
        assert problems(store, index) == []


def assert_raw(got: Episode, one: Made, steps: int | None = None) -> None:
    """All that a raw trajectory holds, of its first rows."""
    steps = one.steps if steps is None else steps
    assert got.seed == one.seed
    np.testing.assert_array_equal(got.qpos, one.qpos[:steps], strict=True)
    np.testing.assert_array_equal(got.qvel, one.qvel[:steps], strict=True)
    np.testing.assert_array_equal(got.action, one.action[:steps], strict=True)
    np.testing.assert_array_equal(got.poses["barrier"], one.barrier[:steps, :7], strict=True)
    for name, camera in OURS.items():
        np.testing.assert_array_equal(got.images[camera], one.rgb[name][:steps], strict=True)


# Raw trajectories


def test_raw_trajectories_come_whole(tmp_path: Path, command: Command) -> None:
    path, to = raw(tmp_path / "LiftBarrier-rf/x.h5", EPISODES, depth=True), tmp_path / "s.zarr"
    code, said, _ = command(path, to, "--dry-run")
    assert code == 0 and "would hold 3 episodes of lift_barrier, 16 steps, 2 arms" in said and not to.exists()
    assert command(path, to)[0] == 0
    store = Store.open(to)
    assert store.cameras == ("global", "agent1", "agent2") and store.objects == ("barrier",)
    for index, one in enumerate(EPISODES):
        got = store.episode(index)
        assert_raw(got, one)
        for name, camera in OURS.items():
            depth = got.extras[f"depth_{camera}"]
            np.testing.assert_array_equal(depth, one.depth[name][:-1, ..., 0].astype(np.uint16), strict=True)
        assert got.judged is not None and got.judged.holds[:, 0].tolist() == [False] * (one.steps - 1) + [
            True
        ]
        assert got.certificate["imported"] == f"traj_{index}" and problems(store, index) == []
        half = one.steps // 2
        assert got.subgoal is not None and got.subgoal[:, 0].tolist() == [0] * half + [1] * (one.steps - half)
    card = to.with_suffix(".md").read_text()
    assert "trajectories of ManiSkill's RecordEpisode" in card and "license: unknown" in card
    assert "| subgoals |" in card and "| calibration |" not in card and "RoboBrain proposes" not in card


def test_raw_trajectories_say_where_arms_and_cameras_stand(tmp_path: Path, command: Command) -> None:
    path, to = raw(tmp_path / "x.h5", EPISODES), tmp_path / "s.zarr"
    assert command(path, to)[0] == 0
    store = Store.open(to)
    assert store.description is not None
    np.testing.assert_allclose(store.description.world_from_base, BASES, atol=1e-6)
    scene = store.identity["scene"]
    for name, camera in OURS.items():
        model = store.description.camera_models[camera]
        np.testing.assert_allclose(model["world_from_camera"], CAMERAS[name].world_from_camera, atol=1e-6)
        again = type(CAMERAS[name])(**scene["cameras"][camera])
        np.testing.assert_allclose(again.world_from_camera, CAMERAS[name].world_from_camera, atol=1e-6)
        assert abs(again.fov_deg - FOV_DEG) < 1e-4
    assert [round(each["yaw_deg"], 3) for each in scene["robots"]] == [90, -90]


def test_a_camera_that_stands_elsewhere_in_one_trajectory_is_told_in_its_certificate(
    tmp_path: Path, command: Command
) -> None:
    path, to = raw(tmp_path / "x.h5", EPISODES[:2]), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        params: Any = file["traj_1/obs/sensor_param/head_camera_agent0"]
        params["extrinsic_cv"][:, 0, 3] += 0.1
        params["cam2world_gl"][:, :3, 3] -= 0.1 * params["extrinsic_cv"][0, 0, :3]
    assert command(path, to)[0] == 0
    certificates = Store.open(to).certificates
    assert "calibration" not in certificates[0]
    moved = np.array(certificates[1]["calibration"]["cameras"]["agent1"]["parent_from_camera"])
    assert abs(np.linalg.norm(moved[:3, 3] - CAMERAS["head_camera_agent0"].eye_m) - 0.1) < 1e-5


def test_rows_after_the_first_success_and_trajectories_without_are_left_out(
    tmp_path: Path, command: Command
) -> None:
    path, to = raw(tmp_path / "x.h5", EPISODES, surplus=2), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        file["traj_1/success"][:] = False  # pyright: ignore[reportIndexIssue]
    code, said, _ = command(path, to)
    assert code == 0 and "1 of 3 trajectories were left out: traj_1 (it never succeeds)" in said
    assert "4 rows after the first success were left out" in said
    store = Store.open(to)
    for index, one in enumerate((EPISODES[0], EPISODES[2])):
        assert_raw(store.episode(index), one, one.steps - 2)
    assert "4 rows after the first success" in to.with_suffix(".md").read_text()


def test_a_trajectory_that_lacks_frames_ends_before_them(tmp_path: Path, command: Command) -> None:
    path, to = raw(tmp_path / "x.h5", EPISODES, surplus=2), tmp_path / "s.zarr"
    shorten(path, "traj_0/obs/sensor_data/head_camera_agent1/rgb", EPISODES[0].steps - 1)
    shorten(path, "traj_2/obs/sensor_data/head_camera_agent1/rgb", 1)
    code, said, _ = command(path, to)
    assert code == 0 and f"rgb has {EPISODES[0].steps - 1} rows, {EPISODES[0].steps} expected" in said
    assert "traj_2 (it never succeeds)" in said  # within the rows that there are
    store = Store.open(to)
    assert_raw(store.episode(0), EPISODES[0], EPISODES[0].steps - 2)


def shorten(path: Path, name: str, rows: int) -> None:
    with h5py.File(path, "r+") as file:
        kept: Any = file[name]
        kept = kept[:rows]
        del file[name]
        file[name] = kept


def test_commands_beyond_the_limits_of_joints_are_meant_at_them(tmp_path: Path, command: Command) -> None:
    one = made(5)
    one.action[2, 0, 3] = 0.4  # the fourth joint goes up to -0.07
    path, to = raw(tmp_path / "x.h5", [one, made(6)]), tmp_path / "s.zarr"
    code, said, _ = command(path, to)
    assert code == 0 and "commands of 1 episodes are up to 0.47 beyond the limits" in said
    got = Store.open(to).episode(0)
    assert abs(got.action[2, 0, 3] + 0.0698) < 1e-6
    np.testing.assert_array_equal(got.executed, one.action, strict=True)


def test_one_arm_has_no_name(tmp_path: Path, command: Command) -> None:
    one, to = made(4, agents=1), tmp_path / "s.zarr"
    assert command(raw(tmp_path / "x.h5", [one]), to)[0] == 0
    got = Store.open(to).episode(0)
    np.testing.assert_array_equal(got.qpos, one.qpos[:-1], strict=True)
    np.testing.assert_array_equal(got.images["agent1"], one.rgb["head_camera"][:-1], strict=True)


def test_what_a_raw_file_lacks_is_made_up_for_and_told(tmp_path: Path, command: Command) -> None:
    """Without observations joints are in the simulator's state; without that they are what was told."""
    path = raw(tmp_path / "x.h5", EPISODES[:1])
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


def test_the_zarr_of_all_arms_is_one_store(tmp_path: Path, command: Command) -> None:
    for arm in (0, 1):
        zarr_arm(tmp_path / "zarr_data", EPISODES, arm)
    assert command(tmp_path / "zarr_data", tmp_path / "s.zarr")[0] == 0
    arms = sorted((tmp_path / "zarr_data").iterdir())
    assert command(*arms, tmp_path / "t.zarr")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    assert (store.attrs["task"], store.cameras, store.agents) == ("lift_barrier", ("agent1", "agent2"), 2)
    assert_told(store, EPISODES)
    assert store.digest() == Store.open(tmp_path / "t.zarr").digest()
    missing = store.identity["imported"]["missing"]
    assert {"poses", "calibration", "measured joints", "success", "seeds"} <= missing.keys()
    assert "policy=paper does without" in (tmp_path / "s.md").read_text()


def test_the_zarr_of_one_arm_is_a_store_of_one(tmp_path: Path, command: Command) -> None:
    path = zarr_arm(tmp_path, EPISODES, 1)
    assert command(path, tmp_path / "s.zarr")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    actions, _ = told(EPISODES)
    np.testing.assert_array_equal(store.action, actions[:, 1:], strict=True)
    np.testing.assert_array_equal(
        store.images["agent1"][:], np.moveaxis(seen(EPISODES, "head_camera_agent1"), 1, -1)
    )


def test_a_joint_zarr_is_a_store(tmp_path: Path, command: Command) -> None:
    path = zarr_joint(tmp_path / "joint.zarr", EPISODES)
    code, _, error = command(path, tmp_path / "s.zarr")
    assert code == 2 and "does not say of which task it is; say so, as in --task lift_barrier" in error
    assert command(path, tmp_path / "s.zarr", "--task", "lift_barrier")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    assert store.cameras == ("global", "agent1", "agent2")
    assert_told(store, EPISODES)


def test_measured_joints_of_a_replay_buffer_are_taken(tmp_path: Path, command: Command) -> None:
    actions, ends = told(EPISODES)
    qpos = np.concatenate([one.qpos[:-1] for one in EPISODES])
    frames = {"head_camera_global": np.moveaxis(seen(EPISODES, "head_camera_global"), 1, -1)}
    columns = {"action": actions.reshape(len(actions), -1), "state": qpos.reshape(len(qpos), -1)}
    path = buffer(tmp_path / "x.zarr", columns, frames, ends)
    assert command(path, tmp_path / "s.zarr", "--task", "lift_barrier")[0] == 0
    store = Store.open(tmp_path / "s.zarr")
    np.testing.assert_array_equal(store.qpos, qpos, strict=True)
    assert_told(store, EPISODES)


@pytest.mark.parametrize("channels_first", [True, False])
def test_policy_lightning_keeps_channels_first_or_last(
    tmp_path: Path, command: Command, channels_first: bool
) -> None:
    path = lightning(tmp_path / "lift.h5", EPISODES, channels_first)
    code, said, _ = command(path, tmp_path / "s.zarr", "--task", "lift_barrier")
    assert code == 0 and "pointcloud was left out" in said
    assert_told(Store.open(tmp_path / "s.zarr"), EPISODES)


# What goes wrong


def test_an_import_goes_on_where_it_was_left(tmp_path: Path, command: Command) -> None:
    path, to = raw(tmp_path / "x.h5", EPISODES), tmp_path / "s.zarr"
    with h5py.File(path, "r+") as file:
        damaged: Any = file["traj_1/obs/sensor_data/head_camera_agent0/rgb"]
        offset, size = damaged.id.get_chunk_info(0).byte_offset, damaged.id.get_chunk_info(0).size
    whole = path.read_bytes()
    path.write_bytes(whole[:offset] + bytes(size) + whole[offset + size :])
    code, _, error = command(path, to)
    assert code == 1 and "x.h5 cannot be imported: /traj_1/obs/sensor_data/head_camera_agent0/rgb" in error
    assert Store.open(to).seeds.tolist() == [7]
    path.write_bytes(whole)
    assert "1 episodes are there, and nothing was written" in command(path, to, "--dry-run")[1]
    assert command(path, to)[0] == 0 and command(path, to)[0] == 0
    store = Store.open(to)
    for index, one in enumerate(EPISODES):
        assert_raw(store.episode(index), one)
    code, _, error = command(raw(tmp_path / "y.h5", EPISODES[:2]), to)
    assert code == 1 and "was made from another configuration" in error and "imported.told" in error


def pickles(folder: Path) -> Path:
    path = folder / "pkl_data/LiftBarrier-rf_Agent0"
    (path / "episode0").mkdir(parents=True)
    (path / "episode0/0.pkl").write_bytes(pickle.dumps({"pointcloud": None}))
    return path


def test_pickles_are_refused_by_name(tmp_path: Path, command: Command) -> None:
    folder = pickles(tmp_path)
    for path in (folder, folder / "episode0/0.pkl", tmp_path / "pkl_data"):
        code, _, error = command(path, tmp_path / "s.zarr")
        assert code == 2 and "none is ever loaded" in error and "motionplanning/<stamp>.h5" in error
    assert not (tmp_path / "s.zarr").exists()


def sound(tmp_path: Path) -> Path:
    return raw(tmp_path / "x.h5", EPISODES[:1])


def broken_json(tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    path = sound(tmp_path)
    said = json.loads(path.with_suffix(".json").read_text())
    change(said)
    path.with_suffix(".json").write_text(json.dumps(said))
    return path


def hdf5(tmp_path: Path, name: str, value: Any) -> Path:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file[name] = value
    return path


def declared(tmp_path: Path, rows: int) -> Path:
    """Frames that are declared, and not there."""
    path = sound(tmp_path)
    with h5py.File(path, "r+") as file:
        name = "traj_0/obs/sensor_data/head_camera_agent0/rgb"
        del file[name]
        file.create_dataset(name, (rows, HEIGHT, WIDTH, 3), np.uint8, chunks=(1, HEIGHT, WIDTH, 3))
    return path


def linked(tmp_path: Path) -> Path:
    path = sound(tmp_path)
    path.rename(elsewhere := tmp_path / "elsewhere.h5")
    with h5py.File(path, "w") as file:
        file["traj_0"] = h5py.ExternalLink(str(elsewhere), "/traj_0")
    return path


def misfit(tmp_path: Path) -> Path:
    zarr_arm(tmp_path / "z", EPISODES, 0)
    shorter = zarr_arm(tmp_path, EPISODES[::-1], 1)
    shorter.rename(tmp_path / "z" / shorter.name)
    return tmp_path / "z"


def lacking(tmp_path: Path) -> Path:
    path = zarr_arm(tmp_path, EPISODES, 0)
    (path / "data/head_camera/0.0.0.0").unlink()
    return path


def pickled_objects(tmp_path: Path) -> Path:
    path = zarr_arm(tmp_path, EPISODES, 0)
    file = path / "data/action/.zarray"
    said = json.loads(file.read_text())
    file.write_text(json.dumps({**said, "dtype": "|O", "filters": [{"id": "pickle", "protocol": 5}]}))
    return path


def several(tmp_path: Path) -> Path:
    for count in (1, 2):
        zarr_arm(tmp_path / "z", EPISODES[:count], 0)
    return tmp_path / "z"


def columns(tmp_path: Path) -> Path:
    return buffer(tmp_path / "pusht.zarr", {"action": np.zeros((9, 2))}, {}, np.array([9]))


REFUSED: dict[str, tuple[Callable[[Path], Path], int, str]] = {
    "nothing": (lambda folder: folder / "no.h5", 2, "there is nothing at"),
    "another control mode": (
        lambda folder: broken_json(
            folder, lambda said: said["episodes"][0].update(control_mode="pd_ee_pose")
        ),
        1,
        "its control mode is 'pd_ee_pose'; expected pd_joint_pos",
    ),
    "another rate": (
        lambda folder: broken_json(
            folder, lambda said: said["env_info"]["env_kwargs"].update(sim_config={"control_freq": 50})
        ),
        1,
        "its control rate is 50 Hz; a store is of 20",
    ),
    "JSON of two": (
        lambda folder: broken_json(folder, lambda said: said["episodes"].append(said["episodes"][0])),
        1,
        "has two episodes 0",
    ),
    "another HDF5": (
        lambda folder: hdf5(folder, "data/demo_0/x", 1),
        2,
        "an HDF5 file with data in it; possible",
    ),
    "frames that are not there": (
        lambda folder: declared(folder, 9),
        1,
        "of which parts are not in the file",
    ),
    "a huge array": (lambda folder: declared(folder, 10**9), 1, "declares 1000000000 rows"),
    "a link": (linked, 1, "/traj_0 is a link to elsewhere"),
    "arms of two sets": (misfit, 1, "these are not arms of one data set"),
    "a lost file": (lacking, 1, "the file data/head_camera/0.0.0.0 is missing"),
    "objects": (pickled_objects, 1, "objects may be pickles, which are never loaded"),
    "several sets": (several, 2, "holds several data sets"),
    "another robot": (columns, 1, "data/action has 2 columns; expected 8 for each arm"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_imported_is_told_before_anything_is_written(
    tmp_path: Path, command: Command, kind: str
) -> None:
    make, code, message = REFUSED[kind]
    path = make(tmp_path)
    got, _, error = command(path, tmp_path / "new" / "s.zarr", "--task", "lift_barrier")
    assert (got, message in error) == (code, True), error
    assert not (tmp_path / "new").exists() and "damaged" not in error


def test_degrees_are_no_joint_targets(tmp_path: Path, command: Command) -> None:
    one = made(1)
    one.action[..., :7] *= 180 / np.pi
    code, _, error = command(raw(tmp_path / "x.h5", [one]), tmp_path / "s.zarr")
    assert code == 1 and "expected absolute joint targets in rad" in error


def test_a_store_is_not_imported(tmp_path: Path, command: Command) -> None:
    assert command(sound(tmp_path), tmp_path / "s.zarr")[0] == 0
    code, _, error = command(tmp_path / "s.zarr", tmp_path / "t.zarr")
    assert code == 2 and "is a store of rf_exp already" in error


def test_what_is_in_the_way_is_never_written_over(tmp_path: Path, command: Command) -> None:
    (there := tmp_path / "there").mkdir()
    (there / "mine.txt").write_text("mine")
    code, _, error = command(sound(tmp_path), there, "--dry-run")
    assert code == 1 and "it is no store of rf_exp" in error
    code, _, error = command(tmp_path / "x.h5", there)
    assert code == 1 and "it is no store of rf_exp" in error and (there / "mine.txt").read_text() == "mine"


def test_another_command_says_how_a_zarr_of_others_becomes_a_store(tmp_path: Path) -> None:
    path = zarr_arm(tmp_path, EPISODES, 0)
    with pytest.raises(Exception, match=r"nothing is wrong with it.*python -m rf_exp\.data import .* NEW"):
        Store.open(path)
    assert zarr.open_group(path, mode="r")["data/action"].shape[0] == 16  # pyright: ignore
