"""The replay buffer: what goes in comes out, and nothing that went wrong goes unnoticed."""

import os
import re
import resource
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_exp.artifacts import commit
from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import Store, empty_like, layout
from rf_exp.types import Episode

IDENTITY = {
    "task": "lift_barrier",
    "version": "1",
    "generator": "1.1",
    "seed": 100,
    "ranges": {"x_m": (-0.1, 0.1)},
}
AGENTS, CAMERAS, HEIGHT, WIDTH = 2, ("global", "agent1", "agent2"), 6, 8
OBJECTS = ("barrier",)
ARRAYS = (
    11  # qpos, qvel, action, executed, subgoal, pose_barrier, three cameras, seed, certificate; then the ends
)


def make_episode(seed: int, steps: int = 7, cameras: tuple[str, ...] = CAMERAS) -> Episode:
    rng = np.random.default_rng(seed)
    return Episode(
        task="lift_barrier",
        seed=seed,
        qpos=rng.normal(size=(steps, AGENTS, 9)).astype(np.float32),
        qvel=np.zeros((steps, AGENTS, 9), np.float32),  # all zeros must be told from a lost file
        action=rng.normal(size=(steps, AGENTS, 8)).astype(np.float32),
        pictures={c: rng.integers(0, 256, (steps, HEIGHT, WIDTH, 3), np.uint8) for c in cameras},
        certificate={"checks": ["ValidateScheduling"], "seed": seed},
        executed=rng.normal(size=(steps, AGENTS, 8)).astype(np.float32),
        poses={name: rng.normal(size=(steps, 7)).astype(np.float32) for name in OBJECTS},
        subgoal=rng.integers(0, 4, (steps, AGENTS)).astype(np.int16),
    )


def make_store(path: Path, episodes: list[Episode], cameras: tuple[str, ...] = CAMERAS) -> Path:
    with Store.create(path, IDENTITY, AGENTS, cameras, HEIGHT, WIDTH, OBJECTS, True) as store:
        for episode in episodes:
            store.append(episode)
    return path


def assert_same(got: Episode, expected: Episode) -> None:
    assert (got.task, got.seed, got.certificate) == (expected.task, expected.seed, expected.certificate)
    for name in ("qpos", "qvel", "action", "executed", "subgoal"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), strict=True)
    assert set(got.poses) == set(expected.poses)
    for name, poses in expected.poses.items():
        np.testing.assert_array_equal(got.poses[name], poses, strict=True)
    assert set(got.pictures) == set(expected.pictures)
    for camera, frames in expected.pictures.items():
        np.testing.assert_array_equal(got.pictures[camera], frames, strict=True)


# What goes in comes out


def test_a_store_without_poses_and_subgoals_is_still_read(tmp_path: Path) -> None:
    """Data from before they were kept, and what is made now without them."""
    episode = replace(make_episode(0), executed=None, poses={}, subgoal=None)
    with Store.create(tmp_path / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH) as store:
        store.append(episode)
        assert (store.subgoal == -1).all() and store.executed is store.action
    path = tmp_path / "old.zarr"
    attributes = {name: value for name, value in store.attrs.items() if name not in ("objects", "disturbed")}
    empty_like(path, attributes)
    assert not (path / "data" / "subgoal").exists()
    with Store.open(path, IDENTITY, writable=True) as old:
        old.append(episode)
        assert_same(old.episode(0), replace(episode, subgoal=np.full((7, AGENTS), -1, np.int16)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"executed": None}, "no executed actions of its own"),
        ({"poses": {}}, r"poses of \[\]; .* \['barrier'\]"),
    ],
)
def test_an_episode_with_other_arrays_is_refused(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store, pytest.raises(StageError, match=message):
        store.append(replace(make_episode(1), **change))


@settings(max_examples=12, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=5),
    cameras=st.sampled_from([(), ("global",), CAMERAS]),
    reopen=st.booleans(),
)
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], cameras: tuple[str, ...], reopen: bool
) -> None:
    episodes = [make_episode(seed, steps, cameras) for seed, steps in enumerate(lengths)]
    path = tmp_path_factory.mktemp("store") / "demos.zarr"
    make_store(path, [] if reopen else episodes, cameras)
    if reopen:
        for episode in episodes:
            with Store.open(path, IDENTITY, writable=True) as store:
                store.append(episode)
    store = Store.open(path, IDENTITY)
    assert (len(store), store.steps, store.agents, store.cameras) == (
        len(lengths),
        sum(lengths),
        AGENTS,
        cameras,
    )
    assert store.episode_ends.tolist() == np.cumsum(lengths).tolist()
    assert store.seeds.tolist() == list(range(len(lengths)))
    assert store.certificates == [dict(episode.certificate) for episode in episodes]
    np.testing.assert_array_equal(store.action, np.concatenate([e.action for e in episodes]))
    for camera in cameras:
        whole = np.concatenate([episode.pictures[camera] for episode in episodes])
        np.testing.assert_array_equal(store.pictures[camera][:], whole)
    for index, episode in enumerate(episodes):
        assert_same(store.episode(index), episode)
    assert_same(store.episode(-1), episodes[-1])
    with pytest.raises(IndexError, match=rf"episode {len(lengths)} of {len(lengths)}"):
        store.episode(len(lengths))


def test_episodes_longer_than_a_file(tmp_path: Path) -> None:
    episodes = [make_episode(0, 300, ("global",)), make_episode(1, 300, ("global",))]
    store = Store.open(make_store(tmp_path / "long.zarr", episodes, ("global",)))
    assert_same(store.episode(1), episodes[1])
    assert len(list((tmp_path / "long.zarr/data/rgb_global").rglob("c/*/0/0/0"))) == 3  # 256 frames each


def test_a_writer_reads_what_it_wrote(tmp_path: Path) -> None:
    with Store.create(tmp_path / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH, OBJECTS, True) as store:
        for seed in range(3):
            store.append(make_episode(seed))
            assert_same(store.episode(seed), make_episode(seed))
            assert len(store.qpos) == 7 * (seed + 1)


def test_attributes_say_where_the_data_came_from(tmp_path: Path) -> None:
    attrs = Store.open(make_store(tmp_path / "s.zarr", [])).attrs
    assert attrs["task"] == "lift_barrier"
    assert attrs["criteria_version"] == "1"
    assert (attrs["generator"], attrs["commit"]) == ("1.1", commit())
    assert attrs["control_hz"] == 20
    assert attrs["identity"]["ranges"] == {"x_m": [-0.1, 0.1]}
    assert {"python", "numpy", "zarr"} <= set(attrs["versions"])


def test_digest_is_of_the_content(tmp_path: Path) -> None:
    episodes = [make_episode(seed) for seed in range(3)]
    digest = Store.open(make_store(tmp_path / "a.zarr", episodes)).digest()
    assert digest == Store.open(make_store(tmp_path / "b.zarr", episodes)).digest()
    frames = {**episodes[2].pictures, "agent2": episodes[2].pictures["agent2"] ^ 1}
    changed = [*episodes[:2], replace(episodes[2], pictures=frames)]
    assert digest != Store.open(make_store(tmp_path / "c.zarr", changed)).digest()
    assert digest != Store.open(make_store(tmp_path / "d.zarr", episodes[::-1])).digest()


# Interrupted and failed writes


@pytest.mark.parametrize("broken", [0, 4, ARRAYS - 1, ARRAYS])
@pytest.mark.parametrize("moment", ["before", "between", "after"])
def test_interrupted_append_is_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: int, moment: str
) -> None:
    """Stop at one of the nine arrays: before its rows are written, before they count, and after."""
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    calls, write = [], layout.write

    def interrupted(array, start, values):  # type: ignore[no-untyped-def]
        calls.append(array)
        if len(calls) <= broken:
            return write(array, start, values)
        if moment == "between":
            layout.view(array, start + len(values))[start : start + len(values)] = values
        if moment == "after":
            write(array, start, values)
        raise KeyboardInterrupt

    store = Store.open(path, writable=True)
    monkeypatch.setattr(layout, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.append(make_episode(1, steps=9))
    monkeypatch.undo()
    store.close()

    committed = broken == ARRAYS and moment == "after"
    reader = Store.open(path)
    assert len(reader) == 1 + committed
    assert_same(reader.episode(0), make_episode(0))
    assert reader.pictures["global"].shape[0] == reader.steps  # surplus rows do not show
    if committed:
        return
    with Store.open(path, writable=True) as writer:
        assert all(writer._array(f"data/{name}").shape[0] == 7 for name in ("qpos", "action", "rgb_agent2"))
        writer.append(make_episode(1, steps=5))
    assert_same(Store.open(path).episode(1), make_episode(1, steps=5))


def test_leftovers_of_a_killed_writer_are_removed(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    leftover = path / "data/qpos/c/0/0/0.deadbeef.partial"
    leftover.write_bytes(b"half")
    Store.open(path)
    assert leftover.exists()  # a reader changes nothing
    Store.open(path, writable=True).close()
    assert not leftover.exists()


@contextmanager
def small_files(limit_bytes: int) -> Iterator[None]:
    """The operating system refuses to let a file grow beyond the limit: a real OSError in a write."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_no_room_for_an_episode(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store:
        with (
            small_files(20_000),
            pytest.raises(
                StageError,
                match=r"no space left while storing the episode of seed 1 in .*s\.zarr: up to \d+ bytes "
                r"needed, \d+ bytes free .*; its 1 stored episodes are intact: make room",
            ),
        ):
            store.append(make_episode(1, steps=200))
        assert_same(store.episode(0), make_episode(0))
        store.append(make_episode(1))  # with room again it goes on
    assert not list(path.rglob("*.partial"))
    assert_same(Store.open(path).episode(1), make_episode(1))


def test_a_disk_that_fills_up(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", disk], capture_output=True)
    if mounted.returncode:
        pytest.skip("needs the right to mount a small disk; the limit on file sizes is tested without it")
    try:
        store, stored = (
            Store.create(disk / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH, OBJECTS, True),
            0,
        )
        with pytest.raises(StageError, match=r"No space left on device.* stored episodes are intact"):
            for stored in range(100):
                store.append(make_episode(stored, steps=40))
        store.close()
        reader = Store.open(disk / "s.zarr")
        assert len(reader) == stored > 0
        assert_same(reader.episode(stored - 1), make_episode(stored - 1, steps=40))
        with pytest.raises(StageError, match="no space left while creating the store"):
            for copy in range(100):
                Store.create(disk / f"{copy}.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH).close()
        assert not list(disk.glob(".*"))
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(ArgumentError, match=r"cannot create a store at .*file/s\.zarr: .*can be written"):
        Store.create(tmp_path / "file" / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH)


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True):
        assert len(Store.open(path)) == 1  # readers are welcome
        with pytest.raises(StageError, match=r"s\.zarr is being written by another process"):
            Store.open(path, writable=True)
    Store.open(path, writable=True).close()


def test_an_existing_store_is_never_overwritten(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with pytest.raises(StageError, match=r"s\.zarr exists already; open it, delete it, or choose another"):
        Store.create(path, IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH)
    assert len(Store.open(path)) == 1


# Foreign and damaged stores


def test_a_foreign_configuration_is_named_key_by_key(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    asked = {
        "task": "lift_barrier",
        "version": "2",
        "generator": "1.1",
        "ranges": {"x_m": [-0.1, 0.2]},
        "light": 0.1,
    }
    with pytest.raises(StageError) as caught:
        Store.open(path, asked)
    for part in (
        "light: found nothing, wanted 0.1",
        "ranges.x_m: found [-0.1, 0.1], wanted [-0.1, 0.2]",
        "seed: found 100, wanted nothing",
        'version: found "1", wanted "2"',
        "delete it or choose another `out`",
    ):
        assert part in str(caught.value)
    assert "task" not in str(caught.value)
    Store.open(path, IDENTITY)  # tuples and lists are the same thing


def test_identity_holds_plain_values_only(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="described by plain JSON values; found a value of type object"):
        Store.create(tmp_path / "s.zarr", {"x": object()}, AGENTS, CAMERAS, HEIGHT, WIDTH)


@pytest.mark.parametrize("name", ["qpos", "qvel", "rgb_agent1"])
def test_a_lost_file_is_named(tmp_path: Path, name: str) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    shutil.rmtree(path / "data" / name / "c")
    with pytest.raises(
        StageError,
        match=rf"is damaged: data/{name} has only 0 readable rows, 7 expected: rows 0 to 6 in file "
        r"c/.* cannot be read \(file data/.* is missing\); restore it from a copy, "
        r"keep what is whole with .* or delete it and generate",
    ):
        Store.open(path)


def test_a_truncated_file_is_named(tmp_path: Path) -> None:
    episodes = [make_episode(0, 200, ("global",)), make_episode(1, 200, ("global",))]
    path = make_store(tmp_path / "s.zarr", episodes, ("global",))
    file = path / "data/rgb_global/c/1/0/0/0"
    os.truncate(file, file.stat().st_size // 2)
    with pytest.raises(
        StageError, match="data/rgb_global has only 256 readable rows, 400 expected: rows 256 to 399"
    ):
        Store.open(path)


def test_a_shortened_array_is_named(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0), make_episode(1)])
    meta = path / "data/action/zarr.json"
    meta.write_text(re.sub(r"(\"shape\": \[\s*)14", r"\g<1>9", meta.read_text(), count=1))
    with pytest.raises(StageError, match="data/action has 9 rows, 14 expected"):
        Store.open(path)


def test_damage_inside_a_file_is_found_when_it_is_read(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0, 40, ("global",))], ("global",))
    file = path / "data/rgb_global/c/0/0/0/0"
    content = bytearray(file.read_bytes())
    content[200:220] = bytes(20)
    file.write_bytes(content)
    store = Store.open(path)
    with pytest.raises(StageError, match=r"s\.zarr is damaged: data/rgb_global cannot be read"):
        store.episode(0)


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    shutil.rmtree(path / "data/qvel")
    with pytest.raises(StageError, match=r"damaged: data/qvel is missing or cannot be opened \(KeyError"):
        Store.open(path)


def test_ends_that_do_not_rise_are_refused(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0), make_episode(1)])
    with Store.open(path, writable=True) as store:
        store._array("meta/episode_ends")[:] = np.array([14, 7])
    with pytest.raises(StageError, match=r"meta/episode_ends does not rise: \[14, 7\]"):
        Store.open(path)


def test_repeated_seeds_are_refused(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(3), make_episode(4)])
    with Store.open(path, writable=True) as store:
        store._array("meta/seed")[1] = 3
    with pytest.raises(StageError, match=r"meta/seed holds seeds more than once: \[3\]"):
        Store.open(path)


def test_another_layout_is_refused(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store:
        store._group.attrs["agents"] = 3
    with pytest.raises(
        StageError, match=r"data/qpos is float32 \('T', 2, 9\), expected float32 \('T', 3, 9\)"
    ):
        Store.open(path)


def test_another_format_is_refused(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [])
    with Store.open(path, writable=True) as store:
        store._group.attrs["format"] = 99
    with pytest.raises(
        StageError, match="has format 99; this version reads 1 and 2; generate the data again"
    ):
        Store.open(path)


def test_missing_attributes_are_named(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [])
    with Store.open(path, writable=True) as store:
        del store._group.attrs["identity"]
    with pytest.raises(StageError, match="attributes identity are missing"):
        Store.open(path)


def test_no_store_at_all(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"no store at .*; generate the data first \(stages=\[generate\]\)"):
        Store.open(tmp_path / "nothing.zarr")
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(StageError, match="is damaged: the store cannot be opened"):
        Store.open(tmp_path / "empty.zarr")


# Episodes that do not fit


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": "take_photo"}, r"of seed 5 is of task 'take_photo'; .* holds 'lift_barrier'"),
        ({"seed": 0}, "of seed 0 is stored already"),
        ({"pictures": {}}, r"has pictures of \[\]; .* expects \['agent1', 'agent2', 'global'\]"),
        (
            {"action": np.zeros((7, 2, 9), np.float32)},
            r"data/action of the episode of seed 5 is float32 \(7, 2, 9\); expected float32 \(7, 2, 8\)",
        ),
        ({"qvel": np.zeros((7, 2, 9))}, r"data/qvel .* is float64 \(7, 2, 9\); expected float32"),
        ({"qpos": np.full((7, 2, 9), np.nan, np.float32)}, "data/qpos .* holds values that are not finite"),
        ({"qpos": np.zeros((0, 2, 9), np.float32)}, "has no steps; expected at least one"),
    ],
)
def test_an_episode_that_does_not_fit_is_refused(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True) as store, pytest.raises(StageError, match=message):
        store.append(replace(make_episode(5), **change))  # pyright: ignore[reportArgumentType]
    assert len(Store.open(path)) == 1


def test_a_reader_does_not_append(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [])
    with pytest.raises(StageError, match="open for reading; open it with writable=True to append"):
        Store.open(path).append(make_episode(0))
