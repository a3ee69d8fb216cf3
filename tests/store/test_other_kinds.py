"""Files of other kinds: every command names the kind, and does not call the file damaged."""

import json
import pickle
import resource
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numcodecs
import numpy as np
import pytest
import zarr

from rf_exp.command import run_guarded
from rf_exp.data.__main__ import main as data
from rf_exp.errors import StageError
from rf_exp.rescue import main as rescue
from rf_exp.stages import generate_data
from rf_exp.stages.training import training_data
from rf_exp.store import Damage, Store
from tests.conftest import cell_of, experiment
from tests.store.episodes import make_episode, make_store

DEFAULT_EXPERIMENT = experiment()
STEPS, ENDS = 137, [70, 137]


def zarr_2(path: Path) -> None:
    """Writes RoboFactory's demonstrations for Diffusion Policy, one store per agent."""
    group = zarr.open_group(path, mode="w", zarr_format=2)
    blosc = numcodecs.Blosc("zstd", clevel=5, shuffle=1)
    for name in ("action", "state", "tcp_action"):
        actions = np.zeros((STEPS, 8), np.float32)
        group.create_array(f"data/{name}", data=actions, chunks=(100, 8), compressors=blosc)
    frames = np.zeros((STEPS, 3, 24, 32), np.uint8)
    group.create_array("data/head_camera", data=frames, chunks=(100, 3, 24, 32), compressors=blosc)
    group.create_array("meta/episode_ends", data=np.array(ENDS), chunks=(100,), compressors=blosc)


def zarr_3(path: Path) -> None:
    """Writes a replay buffer with its own attributes."""
    group = zarr.open_group(path, mode="w", zarr_format=3, attributes={"task": "pusht", "format": 2})
    group.create_array("data/action", data=np.zeros((STEPS, 2), np.float32))
    group.create_array("meta/episode_ends", data=np.array(ENDS))


def raw(path: Path) -> None:
    """Writes trajectories as ManiSkill's RecordEpisode does."""
    with h5py.File(path, "w") as file:
        file["traj_0/actions/panda-0"] = np.zeros((STEPS, 8))
        file["traj_0/obs/agent/panda-0/qpos"] = np.zeros((STEPS + 1, 9), np.float32)


def lerobot(path: Path) -> None:
    (path / "meta").mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps({"codebase_version": "v2.1", "fps": 20}))


def pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps({"state": [0.0] * 8}))


def zipped(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(".zgroup", '{"zarr_format": 2}')


def pictures(path: Path) -> None:
    path.mkdir()
    (path / "0.png").touch()


def folder_of_stores(path: Path) -> None:
    make_store(path / "fast.zarr", [])


def zarr_3_array(path: Path) -> None:
    zarr.open_array(path, mode="w", zarr_format=3, shape=(3,), dtype="f4")


KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "Zarr 2": (
        zarr_2,
        "a Zarr 2 group, laid out as a replay buffer of Diffusion Policy (data/action (137, 8), "
        "data/head_camera (137, 3, 24, 32), data/state (137, 8), data/tcp_action (137, 8), "
        "meta/episode_ends (2,))",
    ),
    "a Zarr 2 array": (
        lambda path: zarr.open_array(path, mode="w", zarr_format=2, shape=(3,), dtype="f4"),
        "a Zarr 2 array",
    ),
    "Zarr 3": (
        zarr_3,
        "a Zarr 3 group, laid out as a replay buffer of Diffusion Policy (data/action (137, 2), ",
    ),
    "a Zarr 3 array": (zarr_3_array, "a Zarr 3 array"),
    "an empty Zarr 3 group": (lambda path: zarr.create_group(path), "a Zarr 3 group; "),
    "HDF5": (raw, "an HDF5 file"),
    "LeRobot": (lerobot, "a LeRobot data set of version v2.1"),
    "pickle": (pickled, "a pickle"),
    "ZIP": (zipped, "a ZIP archive"),
    "text": (lambda path: path.write_text("hello"), "a file"),
    "empty": (lambda path: path.mkdir(), "an empty folder"),
    "pictures": (pictures, "a folder without zarr.json (0.png)"),
    "a shelf": (folder_of_stores, "a folder of 1 stores (fast.zarr)"),
}


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Output and errors of a command that must end with exit code 1."""

    def call(main: Callable[[], None], *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", ["rf_exp", *map(str, arguments)])
        capsys.readouterr()
        assert run_guarded(main) == 1
        return "".join(capsys.readouterr())

    return call


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_command_names_the_kind_and_reports_no_damage(
    kind: str, tmp_path: Path, commands: Callable[..., str]
) -> None:
    write, description = KINDS[kind]
    configured = replace(DEFAULT_EXPERIMENT, out=tmp_path / "out")
    path = cell_of(configured).data_path
    path.parent.mkdir(parents=True)
    write(path)
    before = {each.name for each in path.parent.iterdir()}
    to = tmp_path / "to"
    messages = {
        "summary": commands(data, "summary", path),
        "validate": commands(data, "validate", path),
        "merge": commands(data, "merge", path, "--to", to),
        "export": commands(data, "export", path, to, "--format", "robomimic"),
        "rescue": commands(rescue, path),
        "rescue, dry run": commands(rescue, path, "--dry-run"),
    }
    assert {each.name for each in path.parent.iterdir()} == before and not to.exists()
    for name, stage in (
        ("train", lambda: training_data(cell_of(configured))),
        ("generate", lambda: generate_data(cell_of(configured))),
    ):
        with pytest.raises(StageError) as caught:
            stage()
        messages[name] = str(caught.value)
    for name, message in messages.items():
        assert f"{path} is {description}" in message, name
        assert "nothing is wrong with it" in message and "expected the folder of one" in message, name
        assert not any(word in message for word in ("damaged", "delete", "rescue")), name


def test_a_part_of_a_store_is_recognised(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    with pytest.raises(StageError, match=rf"data is a part of the store {path}; nothing is wrong with it"):
        Store.open(path / "data")


@pytest.mark.slow
@pytest.mark.parametrize("metadata", [None, "", "{", "[]", '{"zarr_format": 3, "node_type": "group"}'])
def test_a_store_without_attributes_is_damaged_and_cannot_be_rescued(
    tmp_path: Path, commands: Callable[..., str], metadata: str | None
) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    (path / "zarr.json").unlink()
    if metadata is not None:
        (path / "zarr.json").write_text(metadata)
    for message in (
        commands(data, "summary", path),
        commands(data, "validate", path),
        commands(rescue, path, "--dry-run"),
        commands(rescue, path),
    ):
        assert "s.zarr is damaged: " in message
        assert "restore it from a copy, or delete it and generate again" in message
        assert "rf_exp.rescue" not in message


@contextmanager
def no_more_files() -> Iterator[None]:
    """The operating system opens no more files for this process: a real OSError unrelated to the store."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.slow
def test_errors_of_the_operating_system_are_not_damage(tmp_path: Path, commands: Callable[..., str]) -> None:
    path = make_store(tmp_path / "s.zarr", [make_episode(0)])
    store = Store.open(path)
    for read in (lambda: Store.open(path), lambda: store.qpos):
        with (
            no_more_files(),
            pytest.raises(StageError, match=r"cannot be read.*: Too many open files") as caught,
        ):
            read()
        assert not isinstance(caught.value, Damage) and "delete" not in str(caught.value)
    shutil.rmtree(path / "data/qvel")
    with pytest.raises(Damage):
        Store.open(path)
