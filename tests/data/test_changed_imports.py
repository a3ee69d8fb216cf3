"""Third-party files with random changes: each is refused with a reason, or read with the values it holds.

The values are read again here, without the importer. Each change is drawn from its seed.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import zarr
from numpy.typing import NDArray

from rf_exp.data.importing.importer import open_source
from rf_exp.data.importing.source import Source
from rf_exp.data.release import within_limits
from rf_exp.errors import ArgumentError, StageError
from rf_exp.store import flaws
from rf_exp.types import Episode
from tests.data.release_files import (
    CAMERA_NAMES,
    source_episode,
    write_arm_zarr,
    write_joint_zarr,
    write_lightning,
    write_raw,
)

EPISODES = [source_episode(seed, 3) for seed in (1, 2)]
TRIALS = 23  # seeds per kind of change and kind of file: 368 in all
KINDS = ("raw", "zarr", "joint", "lightning")
VALUES: tuple[Any, ...] = (None, -1, 0, 7, 1e300, "x", [], {}, [3], True, [10**30, 8], "|O", "<c16")
pytestmark = pytest.mark.slow
Change = Callable[[Path, np.random.Generator], object]


def write_source(kind: str, folder: Path) -> Path:
    """Writes a file, or the folder of one arm."""
    if kind == "raw":
        return write_raw(folder / "x.h5", EPISODES, depth=True)
    folder.mkdir()
    if kind == "joint":
        return write_joint_zarr(folder / "x.zarr", EPISODES)
    return (
        write_lightning(folder / "x.h5", EPISODES)
        if kind == "lightning"
        else write_arm_zarr(folder, EPISODES, 0)
    )


# Changes


def source_files(path: Path) -> list[Path]:
    paths = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    return paths + [each for each in [path.with_suffix(".json")] if each.is_file()]


def change_bytes(path: Path, rng: np.random.Generator) -> None:
    """Flips a bit, replaces a block, or truncates a file."""
    candidates = source_files(path)
    file = candidates[rng.integers(len(candidates))]
    content = bytearray(file.read_bytes())
    offset, choice = int(rng.integers(len(content))), rng.integers(3)
    if choice == 0:
        content[offset] ^= 1 << int(rng.integers(8))
    elif choice == 1:
        end = min(offset + int(rng.integers(1, 64)), len(content))
        content[offset:end] = rng.bytes(end - offset)
    else:
        del content[offset:]
    file.write_bytes(content)


def array_names(file: Any) -> list[str]:
    """The names of all arrays in an HDF5 file."""
    names: list[str] = []
    file.visititems(lambda name, each: names.append(name) if isinstance(each, h5py.Dataset) else None)
    return names


def change_keys(path: Path, rng: np.random.Generator) -> None:
    """Removes or renames a file or an array, or changes a value in JSON."""
    metadata = [each for each in source_files(path) if each.name == ".zarray" or each.suffix == ".json"]
    if metadata and rng.integers(2):
        change_json(metadata[rng.integers(len(metadata))], rng)
    elif path.is_dir():
        candidates = sorted(each for each in path.rglob("*"))
        chosen = candidates[rng.integers(len(candidates))]
        if rng.integers(2):
            chosen.rename(chosen.with_name(f"{chosen.name}x"))
        else:
            shutil.rmtree(chosen) if chosen.is_dir() else chosen.unlink()
    else:
        with h5py.File(path, "r+") as file:
            names = array_names(file)
            parts = names[rng.integers(len(names))].split("/")
            name = "/".join(parts[: int(rng.integers(1, len(parts) + 1))])
            if rng.integers(2):
                file.move(name, f"{name}x")
            else:
                del file[name]


def change_json(path: Path, rng: np.random.Generator) -> None:
    content = json.loads(path.read_text())
    node: Any = content
    while True:
        keys = [*node] if isinstance(node, dict) else [*range(len(node))]
        if not keys:
            break
        key = keys[rng.integers(len(keys))]
        if isinstance(node[key], dict | list) and node[key] and rng.integers(3):
            node = node[key]
            continue
        if rng.integers(3) == 0:
            del node[key]
        else:
            node[key] = VALUES[rng.integers(len(VALUES))]
        break
    path.write_text(json.dumps(content))


def reshaped(values: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """The values with missing or added rows, or with an axis removed, added or moved."""
    variants: list[Callable[[], NDArray[Any]]] = [
        lambda: values[: int(rng.integers(len(values)))],
        lambda: np.concatenate([values, values[:1]]),
        lambda: values[0],
        lambda: values[..., None],
        lambda: values.T,
        lambda: values[..., :-1],
        lambda: np.concatenate([values, values], axis=-1),
        lambda: values.ravel(),
    ]
    return variants[rng.integers(len(variants))]()


def retyped(values: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """The values in another data type, or with one that is not finite or far too large."""
    kinds = ("f2", "f4", "f8", "i1", "i4", "i8", "u1", "u2", "u8", "?", "S4", "c8", ">f4")
    choice = rng.integers(len(kinds) + 3)
    if choice < len(kinds):
        with np.errstate(all="ignore"):
            return values.astype(kinds[choice])
    invalid = values.astype(np.float32 if values.dtype == np.float32 else np.float64)
    invalid[tuple(rng.integers(size) for size in invalid.shape)] = (np.nan, np.inf, 1e30)[choice - len(kinds)]
    return invalid


def change_array(path: Path, rng: np.random.Generator, modify: Callable[..., NDArray[Any]]) -> None:
    if path.is_dir():
        group: Any = zarr.open_group(path, mode="r+", zarr_format=2)
        names = sorted(f"{each.parent.name}/{each.name}" for each in path.glob("*/*") if each.is_dir())
        name = names[rng.integers(len(names))]
        values = modify(group[name][:], rng)
        shutil.rmtree(path / name)
        group.create_array(name, data=values, config={"write_empty_chunks": True})
        return
    with h5py.File(path, "r+") as file:
        names = array_names(file)
        name = names[rng.integers(len(names))]
        array: Any = file[name]
        values = modify(array[:], rng)
        del file[name]
        file[name] = values


CHANGES: dict[str, Change] = {
    "bytes": change_bytes,
    "keys": change_keys,
    "shapes": lambda path, rng: change_array(path, rng, reshaped),
    "dtypes": lambda path, rng: change_array(path, rng, retyped),
}


# Checks of the imported values


def rows_of(values: Any, start: int, end: int) -> NDArray[np.float32]:
    return np.asarray(values[start:end]).astype(np.float32)


def equal(got: Any, expected: Any) -> bool:
    return np.array_equal(np.asarray(got), np.asarray(expected))


def commands_in_file(episode: Episode) -> NDArray[np.float32]:
    """The commands in the file; the action differs from them only where they exceeded limits."""
    assert episode.executed is None or equal(within_limits(episode.executed)[0], episode.action)
    return episode.commanded


def check_raw(path: Path, source: Source, episodes: list[Episode]) -> None:
    contents = source.contents
    notes = " ".join(contents.notes)
    with h5py.File(path) as file:
        for one in episodes:
            group: Any = file[str(one.certificate["imported"])]
            steps = len(one.qpos)
            assert 0 < steps <= 3
            for arm in (0, 1):
                expected = rows_of(group[f"actions/panda-{arm}"], 0, steps)
                assert equal(commands_in_file(one)[:, arm], expected)
                measured = [
                    f"obs/agent/panda-{k}/{field}" in group for k in (0, 1) for field in ("qpos", "qvel")
                ]
                if all(measured):
                    assert equal(one.qpos[:, arm], rows_of(group[f"obs/agent/panda-{arm}/qpos"], 0, steps))
                    assert equal(one.qvel[:, arm], rows_of(group[f"obs/agent/panda-{arm}/qvel"], 0, steps))
            for name, poses in one.poses.items():
                kind = "actors" if f"env_states/actors/{name}" in group else "articulations"
                assert equal(poses, rows_of(group[f"env_states/{kind}/{name}"], 0, steps)[:, :7])
            for camera, frames in one.images.items():
                name = next((theirs for theirs, ours in CAMERA_NAMES.items() if ours == camera), camera)
                assert equal(frames, group[f"obs/sensor_data/{name}/rgb"][:steps])
            if "success" in group:
                assert np.flatnonzero(group["success"][:])[0] == steps - 1
    if len(episodes) < len(EPISODES):
        assert "left out" in notes or "lacks" in notes, notes
    if len(contents.cameras) < 3:
        assert "camera" in notes or "pictures" in contents.missing
    if not contents.objects:
        assert "poses" in contents.missing
    if contents.description is None:
        assert "success" in contents.missing and "depth was left out: success is not known" in notes
    elif contents.cameras and not contents.description.depth:
        assert "depth" in notes or not any("depth" in name for name in array_names_in(path))
    calibrated = contents.scene and {*contents.scene["cameras"]} == {*contents.cameras}
    assert bool(calibrated) != ("calibration" in contents.missing)
    missing_rows = sum(one.steps for one in EPISODES[: len(episodes)]) - sum(contents.steps)
    assert (
        missing_rows == 0
        or "rows after the first success" in notes
        or "shorter arrays" in notes
        or "left out" in notes
    )


def array_names_in(path: Path) -> list[str]:
    with h5py.File(path) as file:
        return array_names(file)


def check_flat(
    actions: list[Any], ends: Any, frames: dict[str, Any], source: Source, episodes: list[Episode]
) -> None:
    contents = source.contents
    bounds = [0, *np.asarray(ends[:]).tolist()]
    assert contents.steps == [len(one.qpos) for one in episodes] == np.diff(bounds).tolist()
    assert {*contents.cameras} == {*frames} and bool(frames) != ("pictures" in contents.missing)
    for one, start, end in zip(episodes, bounds[:-1], bounds[1:], strict=True):
        expected = np.concatenate([rows_of(each, start, end) for each in actions], axis=1)
        assert equal(commands_in_file(one).reshape(len(expected), -1), expected)
        for camera, values in frames.items():
            pictures = values[start:end]
            assert equal(
                one.images[camera], pictures if pictures.shape[-1] == 3 else np.moveaxis(pictures, 1, -1)
            )


def check_zarr(path: Path, source: Source, episodes: list[Episode]) -> None:
    def read(name: str) -> Any:
        return zarr.open_array(path / name, mode="r", zarr_format=2)

    has_pictures = (path / "data/head_camera").is_dir()
    camera = "agent1" if read("data/action").shape[1] == 8 else "global"  # for all arms
    frames = {camera: read("data/head_camera")} if has_pictures else {}
    renamed = [each.name for each in (path / "data").iterdir() if each.name == "head_camerax"]
    frames |= {name: read(f"data/{name}") for name in renamed}
    check_flat([read("data/action")], read("meta/episode_ends"), frames, source, episodes)


def check_joint(path: Path, source: Source, episodes: list[Episode]) -> None:
    def read(name: str) -> Any:
        return zarr.open_array(path / name, mode="r", zarr_format=2)

    frames = {}
    for each in sorted((path / "data").glob("head_camera*")):
        number = each.name.removeprefix("head_camera_")
        camera = f"agent{int(number) + 1}" if number.isdecimal() else number
        frames[camera if number in ("0", "1", "global") else each.name] = read(f"data/{each.name}")
    omitted = [frames.pop(camera) for camera in {*frames} - {*source.contents.cameras}]
    assert not omitted or any("left out" in note for note in source.contents.notes)
    check_flat([read("data/action")], read("meta/episode_ends"), frames, source, episodes)


def check_lightning(path: Path, source: Source, episodes: list[Episode]) -> None:
    with h5py.File(path) as file:
        data: Any = file
        actions = [data[name] for name in sorted(data) if name in ("action_0", "action_1")]
        frames = {
            camera: data[name] for camera, name in cameras_of(data) if camera in source.contents.cameras
        }
        omitted = [camera for camera, _ in cameras_of(data) if camera not in frames]
        assert not omitted or any("left out" in note for note in source.contents.notes)
        check_flat(actions, data["episode_ends"], frames, source, episodes)


def cameras_of(data: Any) -> Iterator[tuple[str, str]]:
    for name in data:
        if name.startswith("head_cam"):
            number = name.removeprefix("head_cam_")
            yield (f"agent{int(number) + 1}" if number.isdecimal() else name), name


CHECKS = {"raw": check_raw, "zarr": check_zarr, "joint": check_joint, "lightning": check_lightning}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_file_is_refused_or_read_as_it_is(tmp_path: Path, kind: str, change: str) -> None:
    original = write_source(kind, tmp_path / "whole")
    refused = 0
    for seed in range(TRIALS):
        shutil.rmtree(tmp_path / "changed", ignore_errors=True)
        shutil.copytree(tmp_path / "whole", tmp_path / "changed")
        path = tmp_path / "changed" / original.name
        CHANGES[change](path, np.random.default_rng([seed, KINDS.index(kind), list(CHANGES).index(change)]))
        try:
            source = open_source([path], "lift_barrier")
            try:
                episodes = [source.episode(index) for index in range(len(source.contents.seeds))]
            finally:
                source.close()
        except (ArgumentError, StageError) as error:
            refused += 1
            assert str(path) in str(error) or "changed" in str(error), error
            continue
        problems = [problem for one in episodes for problem in flaws(one)]
        assert not [problem for problem in problems if "finite" in problem]
        CHECKS[kind](path, source, episodes)
    assert 0 < refused < TRIALS or change in ("shapes", "dtypes", "keys")


@pytest.mark.parametrize("bytes_kept", [8, 3000])
def test_a_truncated_file_is_refused(tmp_path: Path, bytes_kept: int) -> None:
    """Blosc would read beyond the end, and occasionally find valid data there."""
    path = write_arm_zarr(tmp_path, EPISODES, 0)
    file = path / "data/head_camera/0.0.0.0"
    content = file.read_bytes()
    file.write_bytes(content[:bytes_kept])
    message = f"data/head_camera: the file data/head_camera/0.0.0.0 has {bytes_kept} bytes, and says"
    with pytest.raises(StageError, match=re.escape(message)):
        open_source([path], "lift_barrier")
