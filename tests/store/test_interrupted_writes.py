"""Interrupted writes, full disks and concurrent writers leave stored episodes intact."""

from pathlib import Path

import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import Store, layout
from tests.children import small_disk, small_files
from tests.store.episodes import (
    AGENTS,
    CAMERAS,
    HEIGHT,
    IDENTITY,
    OBJECTS,
    WIDTH,
    assert_same,
    make_episode,
    make_store,
)

# qpos, qvel, action, executed, subgoal, pose_barrier, three cameras, seed, certificate; then the ends
ARRAYS = 11


@pytest.mark.slow
@pytest.mark.parametrize("broken", [0, 4, ARRAYS - 1, ARRAYS])
@pytest.mark.parametrize("moment", ["before", "between", "after"])
def test_an_interrupted_append_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: int, moment: str
) -> None:
    """Stops at one array: before its rows are written, before they count, or after."""
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
    assert reader.images["global"].shape[0] == reader.steps  # surplus rows are hidden
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


def test_missing_space_for_an_episode_is_reported(tmp_path: Path) -> None:
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
        store.append(make_episode(1))  # works once there is space again
    assert not list(path.rglob("*.partial"))
    assert_same(Store.open(path).episode(1), make_episode(1))


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "256k") as disk:
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


def test_an_unwritable_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(ArgumentError, match=r"cannot create a store at .*file/s\.zarr: .*can be written"):
        Store.create(tmp_path / "file" / "s.zarr", IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH)


def test_only_one_writer_is_allowed(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with Store.open(path, writable=True):
        assert len(Store.open(path)) == 1  # readers are allowed
        with pytest.raises(StageError, match=r"s\.zarr is being written by another process"):
            Store.open(path, writable=True)
    Store.open(path, writable=True).close()


def test_an_existing_store_is_never_overwritten(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with pytest.raises(StageError, match=r"s\.zarr exists already; open it, delete it, or choose another"):
        Store.create(path, IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH)
    assert len(Store.open(path)) == 1
