"""Stores in which something was changed, exported: each is refused with a reason, or read as what it says.

What it says is read here from the arrays themselves, and what was exported as each format lays it out.
"""

import io
import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import zarr
from numpy.typing import NDArray
from PIL import Image
from pyarrow import parquet

from rf_exp.data.__main__ import FORMATS, export
from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import Store
from tests.data.release_files import HEIGHT, OURS, WIDTH
from tests.data.test_changed_imports import Change, change_bytes, change_keys, reshaped, retyped
from tests.data.test_release_exports import DESCRIPTION, IDENTITY, NAMES, episode

EACH = 13  # seeds of a kind of change, for each format: 312 in all
SEEDS = (4, 9)
LOCAL = {"agent1": 0, "agent2": 1}  # camera -> arm
Rows = dict[str, NDArray[Any]]  # name of an array of the store -> its rows
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "s.zarr"
    with Store.create(path, IDENTITY, 2, NAMES, HEIGHT, WIDTH, ("barrier",), True, DESCRIPTION) as store:
        for seed in SEEDS:
            store.append(episode(seed))
    return path


# Changes


def names_of(path: Path) -> list[str]:
    """Of its arrays of numbers."""
    names = sorted(f"{each.parent.name}/{each.name}" for each in path.glob("*/*") if each.is_dir())
    return [name for name in names if zarr.open_array(path / name, mode="r").dtype.kind in "biuf"]


def change_array(path: Path, rng: np.random.Generator) -> None:
    """An array of another shape or type, in files that are whole."""
    group: Any = zarr.open_group(path, mode="r+")
    names = names_of(path)
    name = names[rng.integers(len(names))]
    values = (reshaped, retyped)[rng.integers(2)](group[name][:], rng)
    shutil.rmtree(path / name)
    group.create_array(name, data=values)


def change_values(path: Path, rng: np.random.Generator) -> None:
    """Other values where they were: rows that are exchanged, what is no number, other ends, other seeds."""
    group: Any = zarr.open_group(path, mode="r+")
    names = names_of(path)
    array = group[names[rng.integers(len(names))]]
    values = array[:]
    if rng.integers(2):
        values = values[rng.permutation(len(values))]
    elif values.dtype.kind == "f":
        at = tuple(rng.integers(size) for size in values.shape)
        values[at] = (np.nan, np.inf, -1e30, 0)[rng.integers(4)]
    else:
        values = (values + rng.integers(1, 3)).astype(values.dtype)
    array[:] = values


CHANGES: dict[str, Change] = {
    "bytes": change_bytes,
    "keys": change_keys,
    "arrays": change_array,
    "values": change_values,
}


# What a format holds


def tables(folder: Path) -> Rows:
    """LeRobot's data sets: columns of all episodes."""
    files = sorted((folder / "data").rglob("*.parquet"))
    columns: dict[str, list[Any]] = {}
    for file in files:
        for name, cells in parquet.read_table(file).to_pydict().items():
            columns.setdefault(name, []).extend(cells)
    found = {
        "meta/seed": np.array(columns["scene_seed"])[
            [0, *np.flatnonzero(np.diff(columns["episode_index"])) + 1]
        ]
    }
    for name, ours in (
        ("observation.state", "data/qpos"),
        ("action", "data/action"),
        ("executed", "data/executed"),
    ):
        found[ours] = np.array(columns[name], np.float32).reshape(len(columns[name]), 2, -1)
    found["data/pose_barrier"] = np.array(columns["object_poses"], np.float32)
    for camera in NAMES:
        cells = columns[f"observation.images.{camera}"]
        found[f"data/rgb_{camera}"] = np.array([Image.open(io.BytesIO(each["bytes"])) for each in cells])
    return found


def joined(parts: list[Rows]) -> Rows:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def demonstrations(folder: Path) -> Rows:
    """robomimic's groups."""
    with h5py.File(folder / "demonstrations.hdf5") as file:
        data: Any = file["data"]
        parts = []
        for number in range(len(data)):
            demo = data[f"demo_{number}"]
            steps = len(demo["actions"])
            part = {"data/action": demo["actions"][:].reshape(steps, 2, -1)}
            for ours in ("qpos", "qvel"):
                part[f"data/{ours}"] = demo[f"obs/{ours}"][:].reshape(steps, 2, -1)
            part["data/pose_barrier"] = demo["obs/pose_barrier"][:]
            part |= {f"data/rgb_{camera}": demo[f"obs/{camera}_image"][:] for camera in NAMES}
            parts.append(part)
    return joined(parts)


def trajectories(folder: Path) -> Rows:
    """RecordEpisode's, without the row after the last action."""
    described = json.loads((folder / "trajectory.json").read_text())["episodes"]
    parts = []
    with h5py.File(folder / "trajectory.h5") as file:
        for one in described:
            group: Any = file[f"traj_{one['episode_id']}"]
            arms = ("panda-0", "panda-1")
            part = {
                "data/action": np.stack([group[f"actions/{arm}"][:] for arm in arms], axis=1),
                "data/pose_barrier": group["env_states/actors/barrier"][:-1, :7],
            }
            for ours in ("qpos", "qvel"):
                part[f"data/{ours}"] = np.stack(
                    [group[f"obs/agent/{arm}/{ours}"][:-1] for arm in arms], axis=1
                )
            for name, camera in OURS.items():
                part[f"data/rgb_{camera}"] = group[f"obs/sensor_data/{name}/rgb"][:-1]
                part[f"data/depth_{camera}"] = group[f"obs/sensor_data/{name}/depth"][:-1, ..., 0]
            parts.append({name: np.asarray(rows) for name, rows in part.items()})
    return {**joined(parts), "meta/seed": np.array([one["episode_seed"] for one in described])}


def buffers(folder: Path) -> Rows:
    """The release's Zarr 2, one an arm."""
    groups: list[Any] = [zarr.open_group(each, mode="r") for each in sorted(folder.glob("*.zarr"))]
    found = {"data/action": np.stack([group["data/action"][:] for group in groups], axis=1)}
    for camera, arm in LOCAL.items():
        found[f"data/rgb_{camera}"] = np.moveaxis(groups[arm]["data/head_camera"][:], 1, -1)
    return {**found, "meta/episode_ends": groups[0]["meta/episode_ends"][:]}


def lightning(folder: Path) -> Rows:
    with h5py.File(folder / "demonstrations.h5") as file:
        data: Any = file
        found = {"data/action": np.stack([data[f"action_{arm}"][:] for arm in (0, 1)], axis=1)}
        for camera, arm in LOCAL.items():
            found[f"data/rgb_{camera}"] = np.moveaxis(data[f"head_cam_{arm}"][:], 1, -1)
        return {**found, "meta/episode_ends": data["episode_ends"][:]}


READS: dict[str, tuple[Callable[[Path], Rows], str | None]] = {  # and how its pictures are kept
    "lerobot": (tables, "png"),
    "lerobot_v21": (tables, "png"),
    "robomimic": (demonstrations, None),
    "recordepisode": (trajectories, None),
    "robofactory": (buffers, None),
    "policy_lightning": (lightning, None),
}


def said(path: Path, name: str, steps: int) -> NDArray[Any]:
    """What an array of a store says of so many rows."""
    return np.asarray(zarr.open_array(path / name, mode="r", zarr_format=3)[:steps])


def test_every_format_is_exported_from_changed_stores() -> None:
    assert READS.keys() == set(FORMATS)


@pytest.mark.parametrize("form", READS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_store_is_refused_or_exported_as_it_is(
    whole: Path, tmp_path: Path, form: str, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)  # none of these files need outlive a crash
    read, pictures = READS[form]
    path, to = tmp_path / "changed.zarr", tmp_path / "export"
    write = partial(export, path, to, form, pictures)
    refused = 0
    for seed in range(EACH):
        for there in (path, to):
            shutil.rmtree(there, ignore_errors=True)
        shutil.copytree(whole, path)
        rng = np.random.default_rng([seed, list(READS).index(form), list(CHANGES).index(change)])
        CHANGES[change](path, rng)
        try:
            write()
        except (ArgumentError, StageError) as error:
            refused += 1
            assert str(path) in str(error) and not to.exists(), error
            continue
        ends = said(path, "meta/episode_ends", len(SEEDS))
        for name, rows in read(to).items():
            expected = said(path, name, len(SEEDS) if name.startswith("meta/") else int(ends[-1]))
            np.testing.assert_array_equal(rows, expected, err_msg=f"{seed}: {name}")
    assert refused < EACH if change == "values" else refused > 0
