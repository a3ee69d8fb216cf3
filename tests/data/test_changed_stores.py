"""Stores with random changes: each export is refused with a reason, or holds the values of the store.

The values of the store are read here from its arrays, those of the export by the layout of its format.
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
from tests.data.release_files import CAMERA_NAMES, HEIGHT, WIDTH
from tests.data.test_changed_imports import Change, change_bytes, change_keys, reshaped, retyped
from tests.data.test_release_exports import DESCRIPTION, IDENTITY, NAMES, episode

TRIALS = 13  # seeds per kind of change and format: 312 in all
SEEDS = (4, 9)
LOCAL = {"agent1": 0, "agent2": 1}  # camera -> arm
Rows = dict[str, NDArray[Any]]  # name of an array of the store -> its rows
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "s.zarr"
    with Store.create(path, IDENTITY, 2, NAMES, HEIGHT, WIDTH, ("barrier",), True, DESCRIPTION) as store:
        for seed in SEEDS:
            store.append(episode(seed))
    return path


# Changes


def names_of(path: Path) -> list[str]:
    """The names of its numeric arrays."""
    names = sorted(f"{each.parent.name}/{each.name}" for each in path.glob("*/*") if each.is_dir())
    return [name for name in names if zarr.open_array(path / name, mode="r").dtype.kind in "biuf"]


def change_array(path: Path, rng: np.random.Generator) -> None:
    """Replaces an array by one of another shape or type, in valid files."""
    group: Any = zarr.open_group(path, mode="r+")
    names = names_of(path)
    name = names[rng.integers(len(names))]
    values = (reshaped, retyped)[rng.integers(2)](group[name][:], rng)
    shutil.rmtree(path / name)
    group.create_array(name, data=values)


def change_values(path: Path, rng: np.random.Generator) -> None:
    """Changes values: permuted rows, values that are not finite, other ends, other seeds."""
    group: Any = zarr.open_group(path, mode="r+")
    names = names_of(path)
    array = group[names[rng.integers(len(names))]]
    values = array[:]
    if rng.integers(2):
        values = values[rng.permutation(len(values))]
    elif values.dtype.kind == "f":
        index = tuple(rng.integers(size) for size in values.shape)
        values[index] = (np.nan, np.inf, -1e30, 0)[rng.integers(4)]
    else:
        values = (values + rng.integers(1, 3)).astype(values.dtype)
    array[:] = values


CHANGES: dict[str, Change] = {
    "bytes": change_bytes,
    "keys": change_keys,
    "arrays": change_array,
    "values": change_values,
}


# Readers of the formats


def read_lerobot(folder: Path) -> Rows:
    """Rows of LeRobot's data sets: columns of all episodes."""
    files = sorted((folder / "data").rglob("*.parquet"))
    columns: dict[str, list[Any]] = {}
    for file in files:
        for name, cells in parquet.read_table(file).to_pydict().items():
            columns.setdefault(name, []).extend(cells)
    rows = {
        "meta/seed": np.array(columns["scene_seed"])[
            [0, *np.flatnonzero(np.diff(columns["episode_index"])) + 1]
        ]
    }
    for name, store_name in (
        ("observation.state", "data/qpos"),
        ("action", "data/action"),
        ("executed", "data/executed"),
    ):
        rows[store_name] = np.array(columns[name], np.float32).reshape(len(columns[name]), 2, -1)
    rows["data/pose_barrier"] = np.array(columns["object_poses"], np.float32)
    for camera in NAMES:
        cells = columns[f"observation.images.{camera}"]
        rows[f"data/rgb_{camera}"] = np.array([Image.open(io.BytesIO(each["bytes"])) for each in cells])
    return rows


def concatenated(parts: list[Rows]) -> Rows:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def read_robomimic(folder: Path) -> Rows:
    """Rows of robomimic's groups."""
    with h5py.File(folder / "demonstrations.hdf5") as file:
        data: Any = file["data"]
        parts = []
        for number in range(len(data)):
            demo = data[f"demo_{number}"]
            steps = len(demo["actions"])
            part = {"data/action": demo["actions"][:].reshape(steps, 2, -1)}
            for field in ("qpos", "qvel"):
                part[f"data/{field}"] = demo[f"obs/{field}"][:].reshape(steps, 2, -1)
            part["data/pose_barrier"] = demo["obs/pose_barrier"][:]
            part |= {f"data/rgb_{camera}": demo[f"obs/{camera}_image"][:] for camera in NAMES}
            parts.append(part)
    return concatenated(parts)


def read_recordepisode(folder: Path) -> Rows:
    """Rows of RecordEpisode, without the one after the last action."""
    metadata = json.loads((folder / "trajectory.json").read_text())["episodes"]
    parts = []
    with h5py.File(folder / "trajectory.h5") as file:
        for entry in metadata:
            group: Any = file[f"traj_{entry['episode_id']}"]
            arms = ("panda-0", "panda-1")
            part = {
                "data/action": np.stack([group[f"actions/{arm}"][:] for arm in arms], axis=1),
                "data/pose_barrier": group["env_states/actors/barrier"][:-1, :7],
            }
            for field in ("qpos", "qvel"):
                part[f"data/{field}"] = np.stack(
                    [group[f"obs/agent/{arm}/{field}"][:-1] for arm in arms], axis=1
                )
            for name, camera in CAMERA_NAMES.items():
                part[f"data/rgb_{camera}"] = group[f"obs/sensor_data/{name}/rgb"][:-1]
                part[f"data/depth_{camera}"] = group[f"obs/sensor_data/{name}/depth"][:-1, ..., 0]
            parts.append({name: np.asarray(rows) for name, rows in part.items()})
    return {**concatenated(parts), "meta/seed": np.array([entry["episode_seed"] for entry in metadata])}


def read_robofactory(folder: Path) -> Rows:
    """Rows of the release's Zarr 2, one file per arm."""
    groups: list[Any] = [zarr.open_group(each, mode="r") for each in sorted(folder.glob("*.zarr"))]
    rows = {"data/action": np.stack([group["data/action"][:] for group in groups], axis=1)}
    for camera, arm in LOCAL.items():
        rows[f"data/rgb_{camera}"] = np.moveaxis(groups[arm]["data/head_camera"][:], 1, -1)
    return {**rows, "meta/episode_ends": groups[0]["meta/episode_ends"][:]}


def read_lightning(folder: Path) -> Rows:
    with h5py.File(folder / "demonstrations.h5") as file:
        data: Any = file
        rows = {"data/action": np.stack([data[f"action_{arm}"][:] for arm in (0, 1)], axis=1)}
        for camera, arm in LOCAL.items():
            rows[f"data/rgb_{camera}"] = np.moveaxis(data[f"head_cam_{arm}"][:], 1, -1)
        return {**rows, "meta/episode_ends": data["episode_ends"][:]}


READERS: dict[str, tuple[Callable[[Path], Rows], str | None]] = {  # reader, and format of the pictures
    "lerobot": (read_lerobot, "png"),
    "lerobot_v21": (read_lerobot, "png"),
    "robomimic": (read_robomimic, None),
    "recordepisode": (read_recordepisode, None),
    "robofactory": (read_robofactory, None),
    "policy_lightning": (read_lightning, None),
}


def rows_of(path: Path, name: str, steps: int) -> NDArray[Any]:
    """The first rows of an array of a store."""
    return np.asarray(zarr.open_array(path / name, mode="r", zarr_format=3)[:steps])


def test_every_format_is_exported_from_changed_stores() -> None:
    assert READERS.keys() == set(FORMATS)


@pytest.mark.parametrize("form", READERS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_store_is_refused_or_exported_as_it_is(
    original: Path, tmp_path: Path, form: str, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)  # these files need not survive a crash
    read, pictures = READERS[form]
    path, exported = tmp_path / "changed.zarr", tmp_path / "export"
    write = partial(export, path, exported, form, pictures)
    refused = 0
    for seed in range(TRIALS):
        for folder in (path, exported):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(original, path)
        rng = np.random.default_rng([seed, list(READERS).index(form), list(CHANGES).index(change)])
        CHANGES[change](path, rng)
        try:
            write()
        except (ArgumentError, StageError) as error:
            refused += 1
            assert str(path) in str(error) and not exported.exists(), error
            continue
        ends = rows_of(path, "meta/episode_ends", len(SEEDS))
        for name, rows in read(exported).items():
            expected = rows_of(path, name, len(SEEDS) if name.startswith("meta/") else int(ends[-1]))
            np.testing.assert_array_equal(rows, expected, err_msg=f"{seed}: {name}")
    assert refused < TRIALS if change == "values" else refused > 0
