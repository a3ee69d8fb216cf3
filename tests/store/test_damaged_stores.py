"""Stores of another configuration and damaged stores are refused with the reason."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import Store
from tests.store.episodes import AGENTS, CAMERAS, HEIGHT, IDENTITY, WIDTH, make_episode, make_store


def test_differences_to_another_configuration_are_listed(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    identity = {
        "task": "lift_barrier",
        "version": "2",
        "generator": "1.1",
        "ranges": {"x_m": [-0.1, 0.2]},
        "light": 0.1,
    }
    with pytest.raises(StageError) as caught:
        Store.open(path, identity)
    for part in (
        "light: found nothing, wanted 0.1",
        "ranges.x_m: found [-0.1, 0.1], wanted [-0.1, 0.2]",
        "seed: found 100, wanted nothing",
        'version: found "1", wanted "2"',
        "delete it or choose another `out`",
    ):
        assert part in str(caught.value)
    assert "task" not in str(caught.value)
    Store.open(path, IDENTITY)  # tuples equal lists


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


def test_damage_within_a_file_is_found_on_reading(tmp_path: Path) -> None:
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


def test_ends_that_do_not_increase_are_refused(tmp_path: Path) -> None:
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
        StageError,
        match=r"has format 99, made by rf_exp 0\.1\.0, commit .*; this version reads 3: generate",
    ):
        Store.open(path)


def test_missing_attributes_are_named(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [])
    with Store.open(path, writable=True) as store:
        del store._group.attrs["identity"]
    with pytest.raises(StageError, match="attributes identity are missing"):
        Store.open(path)


def test_a_missing_store_is_reported(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"no store at .*; generate the data first \(stages=\[generate\]\)"):
        Store.open(tmp_path / "nothing.zarr")
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(StageError, match="is an empty folder; nothing is wrong with it, but it is no store"):
        Store.open(tmp_path / "empty.zarr")
