"""Exports of our data in third-party formats: read as their own readers do, and imported again."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import zarr
from numpy.typing import NDArray

from rf_exp.robots import DEFAULT
from rf_exp.store import Description, Store
from rf_exp.types import UNITS, Episode, Judged
from tests.data.release_files import BASES, CAMERA_NAMES, CAMERAS, HEIGHT, WIDTH, source_episode

IDENTITY = {"task": "lift_barrier", "version": "1", "generator": "1.1", "seed": 100}
NAMES = ("global", "agent1", "agent2")
MODELS = {
    own_name: CAMERAS[name].model(CAMERAS[name].world_from_camera, (WIDTH, HEIGHT))
    for name, own_name in CAMERA_NAMES.items()
}
DESCRIPTION = Description(
    language={"title": "Lift Barrier", "description": "Lift it.", "target_condition": "It is up."},
    conditions=("lifted",),
    world_from_base=[base.tolist() for base in BASES],
    camera_models={
        name: {"intrinsics": each.intrinsics.tolist(), "world_from_camera": each.world_from_camera.tolist()}
        for name, each in MODELS.items()
    },
    depth=True,
)
SEEDS = (4, 9, 11)
Command = Callable[..., Any]
pytestmark = pytest.mark.slow


def episode(seed: int) -> Episode:
    """A disturbed episode with all data that a store may hold, within the limits of joints."""
    source = source_episode(seed, 5 + seed % 3)
    rows, holds = slice(source.steps), np.arange(source.steps)[:, None] == source.steps - 1
    value = holds.astype(np.float32)
    judged = Judged(("lifted",), value, value + 1, np.full(value.shape, UNITS.index("m"), np.uint8), holds)
    depth = {
        f"depth_{CAMERA_NAMES[name]}": each[rows, ..., 0].astype(np.uint16)
        for name, each in source.depth.items()
    }
    return Episode(
        task="lift_barrier",
        seed=seed,
        qpos=source.qpos[rows],
        qvel=source.qvel[rows],
        action=source.action,
        executed=source.action + np.float32(0.01) * np.sin(np.arange(8, dtype=np.float32)),
        images={CAMERA_NAMES[name]: frames[rows] for name, frames in source.rgb.items()},
        poses={"barrier": source.barrier[rows, :7]},
        certificate={"checks": []},
        judged=judged,
        extras=depth,
    )


@pytest.fixture
def store(tmp_path: Path) -> Store:
    size = HEIGHT, WIDTH, ("barrier",), True, DESCRIPTION
    with Store.create(tmp_path / "s.zarr", IDENTITY, 2, NAMES, *size) as new_store:
        for seed in SEEDS:
            new_store.append(episode(seed))
    return Store.open(tmp_path / "s.zarr")


@pytest.fixture
def command(data_command: Command) -> Command:
    return data_command


# As the readers of the formats do


def test_diffusion_policy_reads_the_zarr_of_each_arm(store: Store, tmp_path: Path, command: Command) -> None:
    """The whole replay buffer is copied; the ends of episodes bound the windows that are sampled."""
    to = tmp_path / "zarr"
    assert command("export", store.path, to, "--format", "robofactory")[0] == 0
    for arm in (0, 1):
        path = to / f"LiftBarrier-rf_Agent{arm}_3.zarr"
        assert json.loads((path / ".zgroup").read_text())["zarr_format"] == 2
        root: Any = zarr.open_group(path, mode="r", zarr_format=2)
        buffer = {key: root["data"][key][:] for key in ("head_camera", "state", "action", "tcp_action")}
        ends = root["meta"]["episode_ends"][:]
        assert ends.dtype == np.int64 and ends.tolist() == store.episode_ends.tolist()
        for key in ("state", "action", "tcp_action"):
            assert buffer[key].dtype == np.float32 and root["data"][key].chunks == (100, 8)
            np.testing.assert_array_equal(buffer[key], store.action[:, arm])
        assert buffer["head_camera"].shape == (store.steps, 3, HEIGHT, WIDTH)
        assert buffer["head_camera"].dtype == np.uint8
        pictures = np.moveaxis(buffer["head_camera"], 1, -1)
        np.testing.assert_array_equal(pictures, store.images[f"agent{arm + 1}"][:])
        metadata = json.loads((path / "data/head_camera/.zarray").read_text())
        assert (metadata["compressor"]["id"], metadata["compressor"]["cname"]) == ("blosc", "zstd")
    assert "RoboFactory" in (to / "README.md").read_text()


def in_memory(group: Any) -> dict[str, Any]:
    """An HDF5 group in memory, as ManiSkill's trajectory data set loads it."""
    return {key: in_memory(each) if isinstance(each, h5py.Group) else each[:] for key, each in group.items()}


def first_rows(value: Any, rows: int) -> Any:
    """The first rows of all arrays in a tree."""
    return (
        {key: first_rows(each, rows) for key, each in value.items()}
        if isinstance(value, dict)
        else value[:rows]
    )


def test_maniskill_reads_exported_trajectories(store: Store, tmp_path: Path, command: Command) -> None:
    """Whole trajectories by the JSON file, without the observation after the last action."""
    to = tmp_path / "demos"
    assert command("export", store.path, to, "--format", "recordepisode")[0] == 0
    path = str(to / "trajectory.h5")
    with h5py.File(path) as file, open(path.replace(".h5", ".json")) as json_file:
        metadata = json.load(json_file)
        assert metadata["env_info"]["env_id"] == "LiftBarrier-rf" and "env_kwargs" in metadata["env_info"]
        assert [each["episode_seed"] for each in metadata["episodes"]] == [*SEEDS]
        for entry in metadata["episodes"]:
            assert entry["success"] and entry["control_mode"] == "pd_joint_pos"
            trajectory = in_memory(file[f"traj_{entry['episode_id']}"])
            steps = entry["elapsed_steps"]
            expected, obs = episode(entry["episode_seed"]), first_rows(trajectory["obs"], steps)
            assert trajectory["success"].tolist() == [False] * (steps - 1) + [True]
            assert len(trajectory["terminated"]) == len(trajectory["truncated"]) == steps
            for arm in (0, 1):
                name = f"panda-{arm}"
                np.testing.assert_array_equal(trajectory["actions"][name], expected.action[:, arm])
                np.testing.assert_array_equal(obs["agent"][name]["qpos"], expected.qpos[:, arm])
                assert len(trajectory["obs"]["agent"][name]["qvel"]) == steps + 1
            for name, camera in CAMERA_NAMES.items():
                np.testing.assert_array_equal(obs["sensor_data"][name]["rgb"], expected.images[camera])
                depth = obs["sensor_data"][name]["depth"]
                assert depth.dtype == np.int16 and depth.shape == (steps, HEIGHT, WIDTH, 1)
                pose = obs["sensor_param"][name]["cam2world_gl"][0] @ np.diag([1, -1, -1, 1])
                np.testing.assert_allclose(pose, MODELS[camera].world_from_camera, atol=1e-6)
                extrinsic = obs["sensor_param"][name]["extrinsic_cv"][0]
                np.testing.assert_allclose(extrinsic, np.linalg.inv(pose)[:3], atol=1e-6)
            states = trajectory["env_states"]
            assert states["actors"]["barrier"].shape == (steps + 1, 13)
            assert states["articulations"]["panda-agent-0"].shape == (steps + 1, 13 + 18)


def windows(ends: NDArray[np.int64], length: int) -> list[tuple[int, int]]:
    """First row and end (exclusive) of each window within an episode."""
    starts = [0, *ends[:-1].tolist()]
    return [
        (start, start + length)
        for a, b in zip(starts, ends.tolist(), strict=True)
        for start in range(a, b - length + 1)
    ]


def test_policy_lightning_reads_its_file(store: Store, tmp_path: Path, command: Command) -> None:
    """Windows of pictures (channels first) and of commands, by name and index of arm."""
    to = tmp_path / "lightning"
    assert command("export", store.path, to, "--format", "policy_lightning")[0] == 0
    with h5py.File(to / "demonstrations.h5") as file:
        data: Any = file
        ends = data["episode_ends"][:]
        spans = windows(ends, 4)
        assert len(spans) == sum(5 + seed % 3 - 3 for seed in SEEDS)
        for start, end in spans:
            for arm in (0, 1):
                frames = data[f"head_cam_{arm}"][start:end].astype(np.float32) / 255
                assert frames.shape == (4, 3, HEIGHT, WIDTH)
                pictures = np.asarray(store.images[f"agent{arm + 1}"][start:end])
                np.testing.assert_array_equal(np.moveaxis(frames, 1, -1), pictures.astype(np.float32) / 255)
                np.testing.assert_array_equal(data[f"action_{arm}"][start:end], store.action[start:end, arm])


# Export and import


def assert_same_commands(actual: Episode, expected: Episode, cameras: tuple[str, ...]) -> None:
    np.testing.assert_array_equal(actual.action, expected.action, strict=True)
    assert set(actual.images) == {*cameras}
    for camera in cameras:
        np.testing.assert_array_equal(actual.images[camera], expected.images[camera], strict=True)


@pytest.mark.parametrize("pictures", ["gzip", "plain"])
def test_trajectories_survive_export_and_import(
    store: Store, tmp_path: Path, command: Command, pictures: str
) -> None:
    """Such a file holds no certificates, subgoals or values of conditions."""
    exported = "export", store.path, tmp_path / "x", "--format", "recordepisode", "--pictures", pictures
    assert command(*exported)[0] == 0
    assert command("import", tmp_path / "x", tmp_path / "t.zarr")[0] == 0
    imported = Store.open(tmp_path / "t.zarr")
    assert imported.identity["imported"]["missing"].keys() == {"subgoals", "certificates"}
    assert (imported.attrs["task"], imported.seeds.tolist(), imported.cameras) == (
        "lift_barrier",
        [*SEEDS],
        NAMES,
    )
    assert imported.identity["imported"]["notes"] == []
    for index in range(len(store)):
        actual, expected = imported.episode(index), store.episode(index)
        assert_same_commands(actual, expected, NAMES)
        for name in ("qpos", "qvel", "executed"):
            np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), strict=True)
        np.testing.assert_array_equal(actual.poses["barrier"], expected.poses["barrier"], strict=True)
        for name, depth in expected.extras.items():
            np.testing.assert_array_equal(actual.extras[name], depth, strict=True)
    assert imported.description is not None and imported.description.depth
    np.testing.assert_allclose(imported.description.world_from_base, DESCRIPTION.world_from_base, atol=1e-6)
    for camera, model in DESCRIPTION.camera_models.items():
        for key, matrix in model.items():
            np.testing.assert_allclose(imported.description.camera_models[camera][key], matrix, atol=1e-5)


@pytest.mark.parametrize(("form", "cameras"), [("robofactory", NAMES[1:]), ("policy_lightning", NAMES)])
def test_replay_buffers_survive_export_and_import(
    store: Store, tmp_path: Path, command: Command, form: str, cameras: tuple[str, ...]
) -> None:
    assert command("export", store.path, tmp_path / "x", "--format", form)[0] == 0
    assert command("import", tmp_path / "x", tmp_path / "t.zarr", "--task", "lift_barrier")[0] == 0
    imported = Store.open(tmp_path / "t.zarr")
    np.testing.assert_array_equal(imported.episode_ends, store.episode_ends)
    for index in range(len(store)):
        assert_same_commands(imported.episode(index), store.episode(index), cameras)
    # exporting and importing the result again gives the same bytes
    assert command("export", imported.path, tmp_path / "y", "--format", form)[0] == 0
    assert command("import", tmp_path / "y", tmp_path / "u.zarr", "--task", "lift_barrier")[0] == 0
    assert Store.open(tmp_path / "u.zarr").digest() == imported.digest()


def test_one_arm_survives_export_and_import(tmp_path: Path, command: Command) -> None:
    both_arms = episode(4)
    one_arm = replace(
        both_arms,
        qpos=both_arms.qpos[:, :1],
        qvel=both_arms.qvel[:, :1],
        action=both_arms.action[:, :1],
        executed=None,
        images={name: both_arms.images[name] for name in NAMES[:2]},
        judged=None,
        extras={},
    )
    with Store.create(tmp_path / "s.zarr", IDENTITY, 1, NAMES[:2], HEIGHT, WIDTH, ("barrier",)) as new_store:
        new_store.append(one_arm)
    for form in ("recordepisode", "robofactory", "policy_lightning"):
        assert command("export", tmp_path / "s.zarr", tmp_path / form, "--format", form)[0] == 0
        to = tmp_path / f"{form}.zarr"
        assert command("import", tmp_path / form, to, "--task", "lift_barrier")[0] == 0
        cameras = NAMES[1:2] if form == "robofactory" else NAMES[:2]
        assert_same_commands(Store.open(to).episode(0), one_arm, cameras)


# Errors, and other robots


def test_data_that_a_format_cannot_hold_is_refused(store: Store, tmp_path: Path, command: Command) -> None:
    with Store.create(tmp_path / "g.zarr", IDENTITY, 2, NAMES[:1], HEIGHT, WIDTH) as bare:
        full = episode(4)
        images = {"global": full.images["global"]}
        bare.append(replace(full, images=images, poses={}, judged=None, extras={}, executed=None))
    code, _, error = command("export", bare.path, tmp_path / "x", "--format", "robofactory")
    assert code == 2 and "has no pictures of agent1, agent2" in error and not (tmp_path / "x").exists()
    identity = {**IDENTITY, "task": "../up"}
    with Store.create(tmp_path / "o.zarr", identity, 2, NAMES[:1], HEIGHT, WIDTH) as badly_named:
        badly_named.append(
            replace(full, task="../up", images=images, poses={}, judged=None, extras={}, executed=None)
        )
    code, _, error = command("export", badly_named.path, tmp_path / "x", "--format", "recordepisode")
    assert code == 2 and "task is '../up'; expected a name such as lift_barrier" in error


def test_other_arms_are_exported_under_their_names(tmp_path: Path, command: Command) -> None:
    """Each arm has columns for its own joints: here an arm with six beside a Panda."""
    robot = replace(
        DEFAULT,
        name="other",
        kind="other",
        joints=tuple(f"j{k}" for k in range(6)),
        rest_rad=(0.0,) * 6,
        aside_rad=(0.0,) * 6,
    )
    size = "x.zarr", IDENTITY, 2, NAMES[:1], HEIGHT, WIDTH, (), False, None, (DEFAULT, robot)
    with Store.create(tmp_path / size[0], *size[1:]) as mixed:
        full = episode(4)
        images = {"global": full.images["global"]}
        mixed.append(replace(full, images=images, poses={}, judged=None, extras={}, executed=None))
    expected = full.action[:, 1, [0, 1, 2, 3, 4, 5, 7]]
    for form, name in (("policy_lightning", "action_1"), ("recordepisode", "traj_0/actions/other-1")):
        assert command("export", mixed.path, tmp_path / form, "--format", form)[0] == 0
        with h5py.File(next((tmp_path / form).glob("*.h*5"))) as file:
            np.testing.assert_array_equal(file[name], expected)  # pyright: ignore[reportArgumentType]
