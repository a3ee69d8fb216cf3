"""rf_exp.data: summary, validation, merging and export; failures leave the data intact."""

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import imageio_ffmpeg
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from rf_exp.data.lerobot import aggregate_stats, value_stats
from rf_exp.data.robomimic import split
from rf_exp.store import Description, Store
from rf_exp.types import UNITS, Episode, Judged
from tests.store.episodes import AGENTS, CAMERAS, HEIGHT, IDENTITY, OBJECTS, WIDTH, assert_same, make_episode
from tests.test_rescue import digest, flip

CONDITIONS = ("lifted", "level")
LABELS = ("nothing", "table", "barrier", "agent1", "agent2")
DESCRIPTION = Description(
    language={"title": "Lift Barrier", "description": "Lift it.", "target_condition": "It is up."},
    conditions=CONDITIONS,
    world_from_base=[np.eye(4).tolist()] * AGENTS,
    camera_models={camera: {"intrinsics": np.eye(3).tolist()} for camera in CAMERAS},
    depth=True,
    labels=LABELS,
)
Command = Callable[..., Any]


def full_episode(seed: int, steps: int = 7) -> Episode:
    """An episode with every kind of data that a store may hold."""
    episode, rng = make_episode(seed, steps), np.random.default_rng(seed)
    poses = episode.poses["barrier"].copy()
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    value = rng.normal(size=(steps, len(CONDITIONS))).astype(np.float32)
    holds = np.ones_like(value, np.bool_)
    judged = Judged(CONDITIONS, value, value + 1, np.full(value.shape, UNITS.index("m"), np.uint8), holds)
    size = steps, HEIGHT, WIDTH
    images: dict[str, Any] = {f"depth_{c}": rng.integers(0, 9999, size, np.uint16) for c in CAMERAS}
    images |= {f"segmentation_{c}": rng.integers(0, 5, size, np.uint8) for c in CAMERAS}
    return replace(
        episode,
        poses={"barrier": poses},
        judged=judged,
        extras=images,
        certificate={"subgoals": [["a"] * 4] * 2},
    )


def store_of(path: Path, seeds: range, identity: dict[str, Any] = IDENTITY) -> Path:
    provenance = {**identity, "first_seed": seeds[0]}
    size = HEIGHT, WIDTH, OBJECTS, True, DESCRIPTION
    with Store.create(path, provenance, AGENTS, CAMERAS, *size) as store:
        for seed in seeds:
            store.append(full_episode(seed, 5 + seed))
    return path


@pytest.fixture
def command(data_command: Command) -> Command:
    return data_command


# The store


def test_an_episode_with_all_data_is_read_as_written(tmp_path: Path) -> None:
    store = Store.open(store_of(tmp_path / "s.zarr", range(3)))
    assert store.description == Description(**DESCRIPTION.attributes())
    for index in range(3):
        read, written = store.episode(index), full_episode(index, 5 + index)
        assert_same(read, written)
        assert read.judged is not None and written.judged is not None and read.judged.names == CONDITIONS
        for name in ("value", "bound", "unit", "holds"):
            np.testing.assert_array_equal(
                getattr(read.judged, name), getattr(written.judged, name), strict=True
            )
        assert set(read.extras) == set(written.extras)
        for name, images in written.extras.items():
            np.testing.assert_array_equal(read.extras[name], images, strict=True)


def test_every_array_has_metadata(tmp_path: Path) -> None:
    store = Store.open(store_of(tmp_path / "s.zarr", range(1)))
    groups: Any = store._group
    for name, array in [*groups["data"].arrays(), *groups["meta"].arrays()]:
        assert len(array.metadata.dimension_names) == array.ndim, name
        assert array.attrs["about"], name
        assert len(array.attrs.get("names", [0] * array.shape[-1])) == array.shape[-1], name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [({"judged": None}, r"judged by \[\]; .*'lifted'"), ({"extras": {}}, r"depth and segmentation \[\]")],
)
def test_an_episode_that_lacks_described_data_is_refused(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = store_of(tmp_path / "s.zarr", range(1))
    with Store.open(path, writable=True) as store, pytest.raises(Exception, match=message):
        store.append(replace(full_episode(9), **change))


# Commands


@pytest.mark.slow
def test_merged_stores_equal_one_made_at_once(tmp_path: Path, command: Command) -> None:
    whole = store_of(tmp_path / "whole.zarr", range(7))
    parts = [store_of(tmp_path / f"{part[0]}.zarr", part) for part in (range(3), range(3, 4), range(4, 7))]
    merged = tmp_path / "merged.zarr"
    code, output, _ = command("merge", *parts[::-1], "--to", merged, "--dry-run")
    assert (code, merged.exists()) == (0, False) and "7 episodes of 3 stores, from seed 0 on" in output
    assert command("merge", *parts[::-1], "--to", merged)[0] == 0
    assert digest(merged) == digest(whole)
    assert "| episodes | 7 |" in merged.with_suffix(".md").read_text()
    code, _, error = command("merge", *parts, "--to", merged)
    assert code == 1 and "merged.zarr exists already; nothing is written over it" in error
    assert digest(merged) == digest(whole)


@pytest.mark.slow
def test_stores_that_do_not_belong_together_are_not_merged(tmp_path: Path, command: Command) -> None:
    first = store_of(tmp_path / "one.zarr", range(2))
    other = store_of(tmp_path / "other.zarr", range(2, 3), {**IDENTITY, "attempts": 9})
    again = store_of(tmp_path / "again.zarr", range(1, 3))
    to = tmp_path / "merged.zarr"
    for second, message in ((other, "identity.attempts: found nothing, wanted 9"), (again, "seed 1 is in")):
        code, _, error = command("merge", first, second, "--to", to)
        assert code == 1 and message in error
    assert {path.name for path in tmp_path.iterdir()} == {"one.zarr", "other.zarr", "again.zarr"}


@pytest.mark.slow
def test_validation_names_what_is_wrong(tmp_path: Path, command: Command) -> None:
    sound, damaged, unsound = (tmp_path / f"{name}.zarr" for name in ("sound", "damaged", "unsound"))
    for path in (sound, damaged):
        store_of(path, range(2))
    flip(damaged / "data/rgb_agent1/c/0/0/0/0")
    episode = full_episode(0)
    assert episode.judged is not None
    judged = replace(episode.judged, holds=episode.judged.holds & [True, False])
    blank = {**episode.images, "global": np.zeros_like(episode.images["global"])}
    subgoal = np.full_like(episode.subgoal, 7)
    poses = {"barrier": episode.poses["barrier"] * 2}
    with Store.create(unsound, IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH, OBJECTS, True, DESCRIPTION) as store:
        store.append(replace(episode, judged=judged, images=blank, subgoal=subgoal, poses=poses))
    assert command("validate", sound)[0] == 0
    code, output, error = command("validate", sound, damaged, unsound)
    assert code == 1 and "2 of 3 stores" in error and "sound.zarr: all 2 episodes" in output
    for message in (
        "damaged.zarr is damaged: data/rgb_agent1",
        "camera global shows nothing",
        "ends without success: not level",
        "not of unit length",
        "no text for",
    ):
        assert message in output


@pytest.mark.slow
def test_the_summary_as_json(tmp_path: Path, command: Command) -> None:
    path = store_of(tmp_path / "s.zarr", range(4))
    code, output, _ = command("summary", path, "--json")
    summary = json.loads(output)[str(path)]
    assert (code, summary["episodes"], summary["steps"], summary["scene seeds"]) == (0, 4, 26, "0 to 3")


# Exports


def lerobot(folder: Path, command: Command, episodes: int, *options: str) -> tuple[Store, Path, Any]:
    """A store of some episodes, the folder of its export, and the metadata in info.json."""
    path, to = store_of(folder / "s.zarr", range(episodes)), folder / "lerobot"
    assert command("export", path, to, *options)[0] == 0
    return Store.open(path), to, json.loads((to / "meta/info.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("pictures", ["video", "png"])
def test_a_lerobot_export_holds_the_values_of_the_store(
    tmp_path: Path, command: Command, pictures: str
) -> None:
    """benchmarks/lerobot_reads.py reads such an export with lerobot."""
    store, to, info = lerobot(tmp_path, command, 3, "--format", "lerobot", "--pictures", pictures)
    table = pq.read_table(to / "data/chunk-000/file-000.parquet")
    assert (info["total_frames"], info["total_episodes"], info["fps"]) == (store.steps, 3, 20)
    for name, values in {"observation.state": store.qpos, "action": store.action}.items():
        exported = np.array(table[name].to_pylist(), np.float32)
        np.testing.assert_array_equal(exported, values.reshape(store.steps, -1))
        assert (
            info["features"][name]["shape"] == [exported.shape[1]] == [len(info["features"][name]["names"])]
        )
    for camera in CAMERAS:
        np.testing.assert_array_equal(exported_pictures(to, table, camera), store.images[camera][:])
    assert table["frame_index"].to_pylist() == [k for e in range(3) for k in range(5 + e)]
    assert np.flatnonzero(table["next.success"].to_pylist()).tolist() == [4, 10, 17]
    card = (to / "README.md").read_text()
    assert all(word in card for word in ("LeRobot", "Lift it.", "- level", "license: mit", "0 to 2"))


def exported_pictures(
    folder: Path, table: Any, camera: str, video: str | None = None
) -> np.ndarray[Any, Any]:
    """The pictures of an export (T, H, W, 3)."""
    key = f"observation.images.{camera}"
    video = video or f"videos/{key}/chunk-000/file-000.mp4"
    if key in table.column_names:
        return np.stack([np.array(Image.open(BytesIO(each["bytes"]))) for each in table[key].to_pylist()])
    frames = imageio_ffmpeg.read_frames(str(folder / video))
    next(frames)
    return np.stack([np.frombuffer(frame, np.uint8).reshape(HEIGHT, WIDTH, 3) for frame in frames])


@pytest.mark.slow
@pytest.mark.parametrize("pictures", ["video", "png"])
def test_an_export_of_version_2_1_has_files_for_each_episode(
    tmp_path: Path, command: Command, pictures: str
) -> None:
    store, to, info = lerobot(tmp_path, command, 3, "--format", "lerobot_v21", "--pictures", pictures)
    assert (info["codebase_version"], info["total_frames"]) == ("v2.1", store.steps)
    assert info["total_videos"] == (3 * len(CAMERAS) if pictures == "video" else 0)
    metadata = {
        name: [json.loads(line) for line in (to / f"meta/{name}.jsonl").read_text().splitlines()]
        for name in ("tasks", "episodes", "episodes_stats")
    }
    assert metadata["tasks"] == [{"task_index": 0, "task": "Lift it."}]
    assert [each["length"] for each in metadata["episodes"]] == [5, 6, 7]
    for index, stats in enumerate(metadata["episodes_stats"]):
        episode = store.episode(index)
        place = {"episode_chunk": 0, "episode_index": index}
        table = pq.read_table(to / info["data_path"].format(**place))
        for name, values in {"observation.state": episode.qpos, "action": episode.action}.items():
            flat = values.reshape(len(values), -1)
            np.testing.assert_array_equal(np.array(table[name].to_pylist(), np.float32), flat)
            np.testing.assert_allclose(stats["stats"][name]["max"], flat.max(axis=0))
        for camera in CAMERAS:
            video = info["video_path"] and info["video_path"].format(
                **place, video_key=f"observation.images.{camera}"
            )
            np.testing.assert_array_equal(exported_pictures(to, table, camera, video), episode.images[camera])
        assert {*stats["stats"][f"observation.images.{CAMERAS[0]}"]} == {"min", "max", "mean", "std", "count"}
        kinds = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
        assert {*kinds} == {*table.column_names}


@pytest.mark.slow
def test_an_export_of_one_agent_holds_its_observations_and_actions(tmp_path: Path, command: Command) -> None:
    options = ("--format", "lerobot", "--pictures", "png", "--agent", "2")
    store, to, info = lerobot(tmp_path, command, 2, *options)
    table = pq.read_table(to / "data/chunk-000/file-000.parquet")
    for name, values in {"observation.state": store.qpos, "action": store.action}.items():
        np.testing.assert_array_equal(np.array(table[name].to_pylist(), np.float32), values[:, 1])
        assert all(each.startswith("agent2.") for each in info["features"][name]["names"])
    cameras = [each for each in CAMERAS if each in ("global", "agent2")]
    assert [name for name in info["features"] if "images" in name] == [
        f"observation.images.{camera}" for camera in cameras
    ]
    assert info["robot_type"] == "1x_franka_panda"
    card = (to / "README.md").read_text()
    assert "measured joints of agent 2," in card and "all agents" not in card


@pytest.mark.slow
def test_a_robomimic_export_holds_the_values_of_the_store(tmp_path: Path, command: Command) -> None:
    """benchmarks/robomimic_reads.py reads such an export with robomimic."""
    path, to = store_of(tmp_path / "s.zarr", range(3)), tmp_path / "robomimic"
    assert command("export", path, to, "--format", "robomimic")[0] == 0
    with h5py.File(to / "demonstrations.hdf5") as file:
        assert file["data"].attrs["total"] == 18
        masks: Any = file["mask"]
        parts = {"train": [b"demo_0", b"demo_1"], "valid": [b"demo_2"]}
        assert {name: names[:].tolist() for name, names in masks.items()} == parts
        for index in range(3):
            exported: Any = file[f"data/demo_{index}"]
            episode = full_episode(index, 5 + index)
            np.testing.assert_array_equal(exported["actions"][:], episode.action.reshape(5 + index, -1))
            np.testing.assert_array_equal(exported["obs/qpos"][:], episode.qpos.reshape(5 + index, -1))
            np.testing.assert_array_equal(exported["obs/pose_barrier"][:], episode.poses["barrier"])
            np.testing.assert_array_equal(exported["obs/agent2_image"][:], episode.images["agent2"])


@pytest.mark.parametrize(
    ("episodes", "valid"), [(1, []), (2, [1]), (9, [8]), (10, [9]), (19, [9]), (30, [9, 19, 29])]
)
def test_the_split_takes_the_last_of_every_ten_for_validation(episodes: int, valid: list[int]) -> None:
    parts = split(episodes)
    assert parts["valid"] == valid and sorted(parts["train"] + valid) == [*range(episodes)]


def test_aggregated_statistics_equal_those_of_all_rows() -> None:
    rng = np.random.default_rng(0)
    parts = [rng.normal(k, 1 + k, (20 + 30 * k, 3)) for k in range(3)]
    aggregated, expected = (
        aggregate_stats([value_stats(part) for part in parts]),
        value_stats(np.concatenate(parts)),
    )
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(aggregated[name], expected[name])


@pytest.mark.slow
def test_a_failed_export_leaves_no_files_and_loses_no_data(tmp_path: Path, command: Command) -> None:
    path, existing = store_of(tmp_path / "s.zarr", range(2)), tmp_path / "there"
    existing.mkdir()
    (existing / "mine.txt").write_text("mine")
    damaged = store_of(tmp_path / "damaged.zarr", range(2))
    flip(damaged / "data/rgb_agent1/c/0/0/0/0")
    (tmp_path / "file").touch()
    before = hashlib.sha256(digest(path).encode()).hexdigest()
    lerobot = ("--format", "lerobot")
    for arguments, code, message in (
        ((path, existing, *lerobot), 1, "there exists already; nothing is written over it"),
        (
            (path, tmp_path / "x", "--format", "rlds"),
            2,
            "unknown format 'rlds'; available: lerobot, lerobot_v21, policy_lightning, recordepisode, rob",
        ),
        ((path, tmp_path / "x", *lerobot, "--agent", "3"), 2, "s.zarr has agents 1 to 2"),
        ((path, tmp_path / "x", "--format", "robomimic", "--agent", "1"), 2, "robomimic holds all arms"),
        ((path, tmp_path / "x", *lerobot, "--pictures", "gif"), 2, "'gif'; available: png, video"),
        ((damaged, tmp_path / "x", *lerobot), 1, "damaged.zarr is damaged: data/rgb_agent1"),
        ((tmp_path / "no.zarr", tmp_path / "x", *lerobot), 1, "no store at"),
        ((path, tmp_path / "file/x", *lerobot), 1, "cannot write"),
    ):
        exit_code, _, error = command("export", *arguments)
        assert (exit_code, message in error) == (code, True), error
    assert command("export", path, tmp_path / "x", *lerobot, "--dry-run")[0] == 0
    assert not (tmp_path / "x").exists() and not list(tmp_path.glob(".*"))
    assert (existing / "mine.txt").read_text() == "mine"
    assert before == hashlib.sha256(digest(path).encode()).hexdigest()


def test_a_missing_library_is_named(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = store_of(tmp_path / "s.zarr", range(1))
    monkeypatch.setitem(sys.modules, "h5py", None)
    code, _, error = command("export", path, tmp_path / "x", "--format", "robomimic")
    assert code == 2 and "needs h5py, which is not installed" in error and ".[export]" in error
    assert not (tmp_path / "x").exists()
