"""Stores that declare impossible sizes are refused before memory of that size is allocated."""

import json
import resource
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rf_exp.command import run_guarded
from rf_exp.data.__main__ import main as data
from rf_exp.errors import StageError
from rf_exp.rescue import main as rescue
from rf_exp.store import Store
from tests.store.episodes import assert_same, make_episode, make_store

EPISODES = [make_episode(seed) for seed in range(2)]
SPARE_B = 2**30  # memory beyond that of the process


@contextmanager
def limited_memory() -> Iterator[None]:
    """Limits the memory of the process, so that a huge allocation fails instead of filling the machine."""
    used_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes + SPARE_B, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def change(metadata: Path, modify: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(metadata.read_text())
    modify(content)
    metadata.write_text(json.dumps(content))


def rows(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda content: content["shape"].__setitem__(0, number)


def chunk(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda content: content["chunk_grid"]["configuration"]["chunk_shape"].__setitem__(0, number)


def codec(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda content: content["codecs"][0]["configuration"]["chunk_shape"].__setitem__(0, number)


ARRAYS = {
    "episode_ends, 1e10 rows": ("meta/episode_ends", rows(10**10)),
    "seed, 1e12 rows": ("meta/seed", rows(10**12)),
    "certificate, 1e12 rows": ("meta/certificate", rows(10**12)),
    "qpos, 1e12 rows": ("data/qpos", rows(10**12)),
    "qpos, 2e6 rows": ("data/qpos", rows(2 * 10**6)),
    "pictures, 1e12 rows": ("data/rgb_global", rows(10**12)),
    "qpos, 1e12 rows a file": ("data/qpos", chunk(10**12)),
    "pictures, 8e9 rows a file": ("data/rgb_global", chunk(8 * 10**9)),
    "pictures, 256 rows a chunk": ("data/rgb_global", codec(256)),
}
ATTRIBUTES = {
    "agents": (10**9, "agents is 1000000000; expected 1 to 99"),
    "height": (10**9, "height is 1000000000; expected 0 to 8192"),
    "width": ("8", "width is '8'; expected 0 to 8192"),
    "cameras": (7, "its attributes do not say which arrays it has"),
    "objects": (None, "its attributes do not say which arrays it has"),
    "conditions": (["lifted"], "its attributes do not say which arrays it has"),
}


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Exit code and output, including errors, of a command with limited memory."""

    def call(main: Callable[[], None], *arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp", *map(str, arguments)])
        capsys.readouterr()
        with limited_memory():
            code = run_guarded(main)
        return code, "".join(capsys.readouterr())

    return call


@pytest.mark.slow
@pytest.mark.parametrize("declared", ARRAYS)
def test_an_array_with_a_wrong_size_is_damaged_and_all_episodes_are_rescued(
    declared: str, tmp_path: Path, run: Callable[..., tuple[int, str]]
) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    name, modify = ARRAYS[declared]
    change(path / name / "zarr.json", modify)
    for command in ("summary", "validate"):
        code, output = run(data, command, path)
        assert code == 1 and f"s.zarr is damaged: {name}" in output
    with limited_memory(), pytest.raises(StageError, match="is damaged"):
        Store.open(path, writable=True)
    code, output = run(rescue, path, "--dry-run")
    assert code == 0 and "2 of 2 episodes can be kept; nothing was changed" in output
    assert run(rescue, path)[0] == 0
    store = Store.open(path)
    for index, episode in enumerate(EPISODES):
        assert_same(store.episode(index), episode)


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_impossible_attributes_are_named(
    name: str, tmp_path: Path, run: Callable[..., tuple[int, str]]
) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    value, message = ATTRIBUTES[name]
    change(path / "zarr.json", lambda content: content["attributes"].__setitem__(name, value))
    for main, *arguments in ((data, "summary", path), (data, "validate", path), (rescue, path, "--dry-run")):
        code, output = run(main, *arguments)
        assert code == 1 and message in output and "or delete it and generate again" in output
        assert "rf_exp.rescue" not in output


def test_rows_left_by_a_killed_append_are_ignored(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    change(path / "data/qpos/zarr.json", rows(3000))
    assert len(Store.open(path)) == 2
    with Store.open(path, writable=True) as store:
        store.append(make_episode(2))
    assert_same(Store.open(path).episode(2), make_episode(2))
