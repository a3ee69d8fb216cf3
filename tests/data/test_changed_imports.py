"""Files of others in which something was changed: each is refused with a reason, or is read as what it says.

What it says is read once more here, without the importer. A change of each kind is drawn by its seed.
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
from tests.data.release_files import OURS, lightning, made, raw, zarr_arm, zarr_joint

EPISODES = [made(seed, 3) for seed in (1, 2)]
EACH = 23  # seeds of a kind of change in a kind of file: 368 in all
KINDS = ("raw", "zarr", "joint", "lightning")
VALUES: tuple[Any, ...] = (None, -1, 0, 7, 1e300, "x", [], {}, [3], True, [10**30, 8], "|O", "<c16")
pytestmark = pytest.mark.slow
Change = Callable[[Path, np.random.Generator], object]


def make(kind: str, folder: Path) -> Path:
    """A file, or the folder of one arm."""
    if kind == "raw":
        return raw(folder / "x.h5", EPISODES, depth=True)
    folder.mkdir()
    if kind == "joint":
        return zarr_joint(folder / "x.zarr", EPISODES)
    return lightning(folder / "x.h5", EPISODES) if kind == "lightning" else zarr_arm(folder, EPISODES, 0)


# Changes


def files(path: Path) -> list[Path]:
    within = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    return within + [each for each in [path.with_suffix(".json")] if each.is_file()]


def change_bytes(path: Path, rng: np.random.Generator) -> None:
    """Bits that are flipped, blocks that are others, an end that is lost."""
    among = files(path)
    file = among[rng.integers(len(among))]
    content = bytearray(file.read_bytes())
    at, how = int(rng.integers(len(content))), rng.integers(3)
    if how == 0:
        content[at] ^= 1 << int(rng.integers(8))
    elif how == 1:
        end = min(at + int(rng.integers(1, 64)), len(content))
        content[at:end] = rng.bytes(end - at)
    else:
        del content[at:]
    file.write_bytes(content)


def arrays(file: Any) -> list[str]:
    """The names of all arrays of HDF5."""
    found: list[str] = []
    file.visititems(lambda name, each: found.append(name) if isinstance(each, h5py.Dataset) else None)
    return found


def change_keys(path: Path, rng: np.random.Generator) -> None:
    """Things that are gone or called otherwise, and values of other kinds in JSON."""
    described = [each for each in files(path) if each.name == ".zarray" or each.suffix == ".json"]
    if described and rng.integers(2):
        change_json(described[rng.integers(len(described))], rng)
    elif path.is_dir():
        among = sorted(each for each in path.rglob("*"))
        chosen = among[rng.integers(len(among))]
        if rng.integers(2):
            chosen.rename(chosen.with_name(f"{chosen.name}x"))
        else:
            shutil.rmtree(chosen) if chosen.is_dir() else chosen.unlink()
    else:
        with h5py.File(path, "r+") as file:
            names = arrays(file)
            parts = names[rng.integers(len(names))].split("/")
            name = "/".join(parts[: int(rng.integers(1, len(parts) + 1))])
            if rng.integers(2):
                file.move(name, f"{name}x")
            else:
                del file[name]


def change_json(path: Path, rng: np.random.Generator) -> None:
    said = json.loads(path.read_text())
    node: Any = said
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
    path.write_text(json.dumps(said))


def reshaped(values: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """Rows that lack, are too many, or an axis that is gone, new or elsewhere."""
    ways: list[Callable[[], NDArray[Any]]] = [
        lambda: values[: int(rng.integers(len(values)))],
        lambda: np.concatenate([values, values[:1]]),
        lambda: values[0],
        lambda: values[..., None],
        lambda: values.T,
        lambda: values[..., :-1],
        lambda: np.concatenate([values, values], axis=-1),
        lambda: values.ravel(),
    ]
    return ways[rng.integers(len(ways))]()


def retyped(values: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """Numbers of another kind, or ones that cannot be."""
    kinds = ("f2", "f4", "f8", "i1", "i4", "i8", "u1", "u2", "u8", "?", "S4", "c8", ">f4")
    how = rng.integers(len(kinds) + 3)
    if how < len(kinds):
        with np.errstate(all="ignore"):
            return values.astype(kinds[how])
    worst = values.astype(np.float32 if values.dtype == np.float32 else np.float64)
    worst[tuple(rng.integers(size) for size in worst.shape)] = (np.nan, np.inf, 1e30)[how - len(kinds)]
    return worst


def change_array(path: Path, rng: np.random.Generator, of: Callable[..., NDArray[Any]]) -> None:
    if path.is_dir():
        group: Any = zarr.open_group(path, mode="r+", zarr_format=2)
        names = sorted(f"{each.parent.name}/{each.name}" for each in path.glob("*/*") if each.is_dir())
        name = names[rng.integers(len(names))]
        values = of(group[name][:], rng)
        shutil.rmtree(path / name)
        group.create_array(name, data=values, config={"write_empty_chunks": True})
        return
    with h5py.File(path, "r+") as file:
        names = arrays(file)
        name = names[rng.integers(len(names))]
        kept: Any = file[name]
        values = of(kept[:], rng)
        del file[name]
        file[name] = values


CHANGES: dict[str, Change] = {
    "bytes": change_bytes,
    "keys": change_keys,
    "shapes": lambda path, rng: change_array(path, rng, reshaped),
    "dtypes": lambda path, rng: change_array(path, rng, retyped),
}


# What a changed file says


def rows_of(values: Any, start: int, end: int) -> NDArray[np.float32]:
    return np.asarray(values[start:end]).astype(np.float32)


def same(got: Any, expected: Any) -> bool:
    return np.array_equal(np.asarray(got), np.asarray(expected))


def commanded(one: Episode) -> NDArray[np.float32]:
    """What the file must have said: as it was executed, where something was beyond limits."""
    assert one.executed is None or same(within_limits(one.executed)[0], one.action)
    return one.commanded


def check_raw(path: Path, source: Source, episodes: list[Episode]) -> None:
    said = source.contents
    notes = " ".join(said.notes)
    with h5py.File(path) as file:
        for one in episodes:
            group: Any = file[str(one.certificate["imported"])]
            steps = len(one.qpos)
            assert 0 < steps <= 3
            for arm in (0, 1):
                expected = rows_of(group[f"actions/panda-{arm}"], 0, steps)
                assert same(commanded(one)[:, arm], expected)
                measured = [
                    f"obs/agent/panda-{k}/{what}" in group for k in (0, 1) for what in ("qpos", "qvel")
                ]
                if all(measured):
                    assert same(one.qpos[:, arm], rows_of(group[f"obs/agent/panda-{arm}/qpos"], 0, steps))
                    assert same(one.qvel[:, arm], rows_of(group[f"obs/agent/panda-{arm}/qvel"], 0, steps))
            for name, poses in one.poses.items():
                kind = "actors" if f"env_states/actors/{name}" in group else "articulations"
                assert same(poses, rows_of(group[f"env_states/{kind}/{name}"], 0, steps)[:, :7])
            for camera, frames in one.images.items():
                name = next((theirs for theirs, ours in OURS.items() if ours == camera), camera)
                assert same(frames, group[f"obs/sensor_data/{name}/rgb"][:steps])
            if "success" in group:
                assert np.flatnonzero(group["success"][:])[0] == steps - 1
    if len(episodes) < len(EPISODES):
        assert "left out" in notes or "lacks" in notes, notes
    if len(said.cameras) < 3:
        assert "camera" in notes or "pictures" in said.missing
    if not said.objects:
        assert "poses" in said.missing
    if said.description is None:
        assert "success" in said.missing and "depth was left out: success is not known" in notes
    elif said.cameras and not said.description.depth:
        assert "depth" in notes or not any("depth" in name for name in arrays_of(path))
    known = said.scene and {*said.scene["cameras"]} == {*said.cameras}
    assert bool(known) != ("calibration" in said.missing)
    short = sum(one.steps for one in EPISODES[: len(episodes)]) - sum(said.steps)
    assert (
        short == 0
        or "rows after the first success" in notes
        or "shorter arrays" in notes
        or "left out" in notes
    )


def arrays_of(path: Path) -> list[str]:
    with h5py.File(path) as file:
        return arrays(file)


def check_flat(
    told: list[Any], ends: Any, frames: dict[str, Any], source: Source, episodes: list[Episode]
) -> None:
    said = source.contents
    bounds = [0, *np.asarray(ends[:]).tolist()]
    assert said.steps == [len(one.qpos) for one in episodes] == np.diff(bounds).tolist()
    assert {*said.cameras} == {*frames} and bool(frames) != ("pictures" in said.missing)
    for one, start, end in zip(episodes, bounds[:-1], bounds[1:], strict=True):
        expected = np.concatenate([rows_of(each, start, end) for each in told], axis=1)
        assert same(commanded(one).reshape(len(expected), -1), expected)
        for camera, values in frames.items():
            shown = values[start:end]
            assert same(one.images[camera], shown if shown.shape[-1] == 3 else np.moveaxis(shown, 1, -1))


def check_zarr(path: Path, source: Source, episodes: list[Episode]) -> None:
    def read(name: str) -> Any:
        return zarr.open_array(path / name, mode="r", zarr_format=2)

    there = (path / "data/head_camera").is_dir()
    camera = "agent1" if read("data/action").shape[1] == 8 else "global"  # of all arms
    frames = {camera: read("data/head_camera")} if there else {}
    other = [each.name for each in (path / "data").iterdir() if each.name == "head_camerax"]
    frames |= {name: read(f"data/{name}") for name in other}
    check_flat([read("data/action")], read("meta/episode_ends"), frames, source, episodes)


def check_joint(path: Path, source: Source, episodes: list[Episode]) -> None:
    def read(name: str) -> Any:
        return zarr.open_array(path / name, mode="r", zarr_format=2)

    frames = {}
    for each in sorted((path / "data").glob("head_camera*")):
        number = each.name.removeprefix("head_camera_")
        camera = f"agent{int(number) + 1}" if number.isdecimal() else number
        frames[camera if number in ("0", "1", "global") else each.name] = read(f"data/{each.name}")
    lost = [frames.pop(camera) for camera in {*frames} - {*source.contents.cameras}]
    assert not lost or any("left out" in note for note in source.contents.notes)
    check_flat([read("data/action")], read("meta/episode_ends"), frames, source, episodes)


def check_lightning(path: Path, source: Source, episodes: list[Episode]) -> None:
    with h5py.File(path) as file:
        data: Any = file
        told = [data[name] for name in sorted(data) if name in ("action_0", "action_1")]
        frames = {
            camera: data[name] for camera, name in cameras_of(data) if camera in source.contents.cameras
        }
        lost = [camera for camera, _ in cameras_of(data) if camera not in frames]
        assert not lost or any("left out" in note for note in source.contents.notes)
        check_flat(told, data["episode_ends"], frames, source, episodes)


def cameras_of(data: Any) -> Iterator[tuple[str, str]]:
    for name in data:
        if name.startswith("head_cam"):
            number = name.removeprefix("head_cam_")
            yield (f"agent{int(number) + 1}" if number.isdecimal() else name), name


CHECKS = {"raw": check_raw, "zarr": check_zarr, "joint": check_joint, "lightning": check_lightning}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", CHANGES)
def test_what_was_changed_is_refused_or_read_as_it_is(tmp_path: Path, kind: str, change: str) -> None:
    whole = make(kind, tmp_path / "whole")
    refused = 0
    for seed in range(EACH):
        shutil.rmtree(tmp_path / "changed", ignore_errors=True)
        shutil.copytree(tmp_path / "whole", tmp_path / "changed")
        path = tmp_path / "changed" / whole.name
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
        wrong = [what for one in episodes for what in flaws(one)]
        assert not [what for what in wrong if "finite" in what]
        CHECKS[kind](path, source, episodes)
    assert 0 < refused < EACH or change in ("shapes", "dtypes", "keys")


@pytest.mark.parametrize("bytes_kept", [8, 3000])
def test_a_file_that_was_cut_is_refused_whatever_lies_behind_it_in_memory(
    tmp_path: Path, bytes_kept: int
) -> None:
    """Blosc would read on there, and now and then find what it looks for."""
    path = zarr_arm(tmp_path, EPISODES, 0)
    file = path / "data/head_camera/0.0.0.0"
    whole = file.read_bytes()
    file.write_bytes(whole[:bytes_kept])
    told = f"data/head_camera: the file data/head_camera/0.0.0.0 has {bytes_kept} bytes, and says"
    with pytest.raises(StageError, match=re.escape(told)):
        open_source([path], "lift_barrier")
