"""Our data in the tools of others: read as they read it, and imported again to what it was."""

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
from tests.data.release_files import BASES, CAMERAS, HEIGHT, OURS, WIDTH, made

IDENTITY = {"task": "lift_barrier", "version": "1", "generator": "1.1", "seed": 100}
NAMES = ("global", "agent1", "agent2")
MODELS = {
    ours: CAMERAS[name].model(CAMERAS[name].world_from_camera, (WIDTH, HEIGHT)) for name, ours in OURS.items()
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
    """A disturbed one with all that a store may hold, within the limits of joints."""
    one = made(seed, 5 + seed % 3)
    rows, holds = slice(one.steps), np.arange(one.steps)[:, None] == one.steps - 1
    value = holds.astype(np.float32)
    judged = Judged(("lifted",), value, value + 1, np.full(value.shape, UNITS.index("m"), np.uint8), holds)
    depth = {f"depth_{OURS[name]}": each[rows, ..., 0].astype(np.uint16) for name, each in one.depth.items()}
    return Episode(
        task="lift_barrier",
        seed=seed,
        qpos=one.qpos[rows],
        qvel=one.qvel[rows],
        action=one.action,
        executed=one.action + np.float32(0.01) * np.sin(np.arange(8, dtype=np.float32)),
        images={OURS[name]: frames[rows] for name, frames in one.rgb.items()},
        poses={"barrier": one.barrier[rows, :7]},
        certificate={"checks": []},
        judged=judged,
        extras=depth,
    )


@pytest.fixture
def store(tmp_path: Path) -> Store:
    size = HEIGHT, WIDTH, ("barrier",), True, DESCRIPTION
    with Store.create(tmp_path / "s.zarr", IDENTITY, 2, NAMES, *size) as made_here:
        for seed in SEEDS:
            made_here.append(episode(seed))
    return Store.open(tmp_path / "s.zarr")


@pytest.fixture
def command(data_command: Command) -> Command:
    return data_command


# As their own readers do


def test_diffusion_policy_reads_the_zarr_of_each_arm(store: Store, tmp_path: Path, command: Command) -> None:
    """A replay buffer is copied as a whole; samples are windows of rows by the ends of episodes."""
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
        shown = np.moveaxis(buffer["head_camera"], 1, -1)
        np.testing.assert_array_equal(shown, store.images[f"agent{arm + 1}"][:])
        described = json.loads((path / "data/head_camera/.zarray").read_text())
        assert (described["compressor"]["id"], described["compressor"]["cname"]) == ("blosc", "zstd")
    assert "RoboFactory" in (to / "README.md").read_text()


def all_of(group: Any) -> dict[str, Any]:
    """A group of HDF5 in memory, as ManiSkill's trajectory data set loads it."""
    return {key: all_of(each) if isinstance(each, h5py.Group) else each[:] for key, each in group.items()}


def cut(value: Any, rows: int) -> Any:
    """The first rows of all arrays in a tree."""
    return {key: cut(each, rows) for key, each in value.items()} if isinstance(value, dict) else value[:rows]


def test_the_release_and_maniskill_read_trajectories(store: Store, tmp_path: Path, command: Command) -> None:
    """By the JSON file, a trajectory as a whole, without the observation after its last action."""
    to = tmp_path / "demos"
    assert command("export", store.path, to, "--format", "recordepisode")[0] == 0
    path = str(to / "trajectory.h5")
    with h5py.File(path) as file, open(path.replace(".h5", ".json")) as beside:
        said = json.load(beside)
        assert said["env_info"]["env_id"] == "LiftBarrier-rf" and "env_kwargs" in said["env_info"]
        assert [each["episode_seed"] for each in said["episodes"]] == [*SEEDS]
        for entry in said["episodes"]:
            assert entry["success"] and entry["control_mode"] == "pd_joint_pos"
            trajectory = all_of(file[f"traj_{entry['episode_id']}"])
            steps = entry["elapsed_steps"]
            got, obs = episode(entry["episode_seed"]), cut(trajectory["obs"], steps)
            assert trajectory["success"].tolist() == [False] * (steps - 1) + [True]
            assert len(trajectory["terminated"]) == len(trajectory["truncated"]) == steps
            for arm in (0, 1):
                name = f"panda-{arm}"
                np.testing.assert_array_equal(trajectory["actions"][name], got.action[:, arm])
                np.testing.assert_array_equal(obs["agent"][name]["qpos"], got.qpos[:, arm])
                assert len(trajectory["obs"]["agent"][name]["qvel"]) == steps + 1
            for name, camera in OURS.items():
                np.testing.assert_array_equal(obs["sensor_data"][name]["rgb"], got.images[camera])
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
    """Rows of each window within an episode."""
    starts = [0, *ends[:-1].tolist()]
    return [
        (at, at + length)
        for a, b in zip(starts, ends.tolist(), strict=True)
        for at in range(a, b - length + 1)
    ]


def test_policy_lightning_reads_its_file(store: Store, tmp_path: Path, command: Command) -> None:
    """Windows of pictures with channels first, and of commands, by names and numbers of arms."""
    to = tmp_path / "lightning"
    assert command("export", store.path, to, "--format", "policy_lightning")[0] == 0
    with h5py.File(to / "demonstrations.h5") as file:
        data: Any = file
        ends = data["episode_ends"][:]
        every = windows(ends, 4)
        assert len(every) == sum(5 + seed % 3 - 3 for seed in SEEDS)
        for start, end in every:
            for arm in (0, 1):
                frames = data[f"head_cam_{arm}"][start:end].astype(np.float32) / 255
                assert frames.shape == (4, 3, HEIGHT, WIDTH)
                shown = np.asarray(store.images[f"agent{arm + 1}"][start:end])
                np.testing.assert_array_equal(np.moveaxis(frames, 1, -1), shown.astype(np.float32) / 255)
                np.testing.assert_array_equal(data[f"action_{arm}"][start:end], store.action[start:end, arm])


# There and back


def assert_same_commands(got: Episode, had: Episode, cameras: tuple[str, ...]) -> None:
    np.testing.assert_array_equal(got.action, had.action, strict=True)
    assert set(got.images) == {*cameras}
    for camera in cameras:
        np.testing.assert_array_equal(got.images[camera], had.images[camera], strict=True)


@pytest.mark.parametrize("pictures", ["gzip", "plain"])
def test_trajectories_come_back_whole(store: Store, tmp_path: Path, command: Command, pictures: str) -> None:
    """Certificates, subgoals and numbers of conditions are not in such a file."""
    exported = "export", store.path, tmp_path / "x", "--format", "recordepisode", "--pictures", pictures
    assert command(*exported)[0] == 0
    assert command("import", tmp_path / "x", tmp_path / "t.zarr")[0] == 0
    back = Store.open(tmp_path / "t.zarr")
    assert back.identity["imported"]["missing"].keys() == {"subgoals", "certificates"}
    assert (back.attrs["task"], back.seeds.tolist(), back.cameras) == ("lift_barrier", [*SEEDS], NAMES)
    assert back.identity["imported"]["notes"] == []
    for index in range(len(store)):
        got, had = back.episode(index), store.episode(index)
        assert_same_commands(got, had, NAMES)
        for name in ("qpos", "qvel", "executed"):
            np.testing.assert_array_equal(getattr(got, name), getattr(had, name), strict=True)
        np.testing.assert_array_equal(got.poses["barrier"], had.poses["barrier"], strict=True)
        for name, depth in had.extras.items():
            np.testing.assert_array_equal(got.extras[name], depth, strict=True)
    assert back.description is not None and back.description.depth
    np.testing.assert_allclose(back.description.world_from_base, DESCRIPTION.world_from_base, atol=1e-6)
    for camera, model in DESCRIPTION.camera_models.items():
        for key, matrix in model.items():
            np.testing.assert_allclose(back.description.camera_models[camera][key], matrix, atol=1e-5)


@pytest.mark.parametrize(("form", "cameras"), [("robofactory", NAMES[1:]), ("policy_lightning", NAMES)])
def test_replay_buffers_come_back_with_all_that_they_hold(
    store: Store, tmp_path: Path, command: Command, form: str, cameras: tuple[str, ...]
) -> None:
    assert command("export", store.path, tmp_path / "x", "--format", form)[0] == 0
    assert command("import", tmp_path / "x", tmp_path / "t.zarr", "--task", "lift_barrier")[0] == 0
    back = Store.open(tmp_path / "t.zarr")
    np.testing.assert_array_equal(back.episode_ends, store.episode_ends)
    for index in range(len(store)):
        assert_same_commands(back.episode(index), store.episode(index), cameras)
    # and once more: what is imported is exported to the same
    assert command("export", back.path, tmp_path / "y", "--format", form)[0] == 0
    assert command("import", tmp_path / "y", tmp_path / "u.zarr", "--task", "lift_barrier")[0] == 0
    assert Store.open(tmp_path / "u.zarr").digest() == back.digest()


def test_an_arm_alone_comes_back(tmp_path: Path, command: Command) -> None:
    one = episode(4)
    alone = replace(
        one,
        qpos=one.qpos[:, :1],
        qvel=one.qvel[:, :1],
        action=one.action[:, :1],
        executed=None,
        images={name: one.images[name] for name in NAMES[:2]},
        judged=None,
        extras={},
    )
    with Store.create(tmp_path / "s.zarr", IDENTITY, 1, NAMES[:2], HEIGHT, WIDTH, ("barrier",)) as made_here:
        made_here.append(alone)
    for form in ("recordepisode", "robofactory", "policy_lightning"):
        assert command("export", tmp_path / "s.zarr", tmp_path / form, "--format", form)[0] == 0
        to = tmp_path / f"{form}.zarr"
        assert command("import", tmp_path / form, to, "--task", "lift_barrier")[0] == 0
        cameras = NAMES[1:2] if form == "robofactory" else NAMES[:2]
        assert_same_commands(Store.open(to).episode(0), alone, cameras)


# What cannot be exported


def test_what_a_format_cannot_hold_is_told(store: Store, tmp_path: Path, command: Command) -> None:
    with Store.create(tmp_path / "g.zarr", IDENTITY, 2, NAMES[:1], HEIGHT, WIDTH) as bare:
        one = episode(4)
        images = {"global": one.images["global"]}
        bare.append(replace(one, images=images, poses={}, judged=None, extras={}, executed=None))
    code, _, error = command("export", bare.path, tmp_path / "x", "--format", "robofactory")
    assert code == 2 and "has no pictures of agent1, agent2" in error and not (tmp_path / "x").exists()
    odd = {**IDENTITY, "task": "../up"}
    with Store.create(tmp_path / "o.zarr", odd, 2, NAMES[:1], HEIGHT, WIDTH) as named:
        named.append(
            replace(one, task="../up", images=images, poses={}, judged=None, extras={}, executed=None)
        )
    code, _, error = command("export", named.path, tmp_path / "x", "--format", "recordepisode")
    assert code == 2 and "task is '../up'; expected a name such as lift_barrier" in error


def test_other_arms_are_exported_by_their_names(tmp_path: Path, command: Command) -> None:
    """Each with the rows of the joints that it has: beside a Panda, an arm with six."""
    robot = replace(
        DEFAULT,
        name="other",
        kind="other",
        joints=tuple(f"j{k}" for k in range(6)),
        rest_rad=(0.0,) * 6,
        aside_rad=(0.0,) * 6,
    )
    size = "x.zarr", IDENTITY, 2, NAMES[:1], HEIGHT, WIDTH, (), False, None, (DEFAULT, robot)
    with Store.create(tmp_path / size[0], *size[1:]) as others:
        one = episode(4)
        images = {"global": one.images["global"]}
        others.append(replace(one, images=images, poses={}, judged=None, extras={}, executed=None))
    told = one.action[:, 1, [0, 1, 2, 3, 4, 5, 7]]
    for form, name in (("policy_lightning", "action_1"), ("recordepisode", "traj_0/actions/other-1")):
        assert command("export", others.path, tmp_path / form, "--format", form)[0] == 0
        with h5py.File(next((tmp_path / form).glob("*.h*5"))) as file:
            np.testing.assert_array_equal(file[name], told)  # pyright: ignore[reportArgumentType]
