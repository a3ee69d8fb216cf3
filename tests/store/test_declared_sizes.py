"""Stores that declare sizes which they cannot have: refused before anything of that size is read or made."""

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
SPARE_B = 2**30  # of memory, beside what the process holds


@contextmanager
def little_memory() -> Iterator[None]:
    """Whoever asks the system for more is refused, so that what would hang or fill the machine fails."""
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (held + SPARE_B, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def change(metadata: Path, changed: Callable[[dict[str, Any]], object]) -> None:
    said = json.loads(metadata.read_text())
    changed(said)
    metadata.write_text(json.dumps(said))


def rows(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda said: said["shape"].__setitem__(0, number)


def chunk(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda said: said["chunk_grid"]["configuration"]["chunk_shape"].__setitem__(0, number)


def codec(number: int) -> Callable[[dict[str, Any]], object]:
    return lambda said: said["codecs"][0]["configuration"]["chunk_shape"].__setitem__(0, number)


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
    """Exit code, and output with errors, of a command that has little memory."""

    def call(main: Callable[[], None], *arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp", *map(str, arguments)])
        capsys.readouterr()
        with little_memory():
            code = run_guarded(main)
        return code, "".join(capsys.readouterr())

    return call


@pytest.mark.slow
@pytest.mark.parametrize("declared", ARRAYS)
def test_an_array_that_declares_what_it_has_not_is_damaged_and_all_episodes_are_rescued(
    declared: str, tmp_path: Path, run: Callable[..., tuple[int, str]]
) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    name, changed = ARRAYS[declared]
    change(path / name / "zarr.json", changed)
    for command in ("summary", "validate"):
        code, told = run(data, command, path)
        assert code == 1 and f"s.zarr is damaged: {name}" in told
    with little_memory(), pytest.raises(StageError, match="is damaged"):
        Store.open(path, writable=True)
    code, told = run(rescue, path, "--dry-run")
    assert code == 0 and "2 of 2 episodes can be kept; nothing was changed" in told
    assert run(rescue, path)[0] == 0
    store = Store.open(path)
    for index, episode in enumerate(EPISODES):
        assert_same(store.episode(index), episode)


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_attributes_that_cannot_be_are_named(
    name: str, tmp_path: Path, run: Callable[..., tuple[int, str]]
) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    value, message = ATTRIBUTES[name]
    change(path / "zarr.json", lambda said: said["attributes"].__setitem__(name, value))
    for main, *arguments in ((data, "summary", path), (data, "validate", path), (rescue, path, "--dry-run")):
        code, told = run(main, *arguments)
        assert code == 1 and message in told and "or delete it and generate again" in told
        assert "rf_exp.rescue" not in told


def test_rows_that_a_killed_append_left_are_no_damage(tmp_path: Path) -> None:
    path = make_store(tmp_path / "s.zarr", EPISODES)
    change(path / "data/qpos/zarr.json", rows(3000))
    assert len(Store.open(path)) == 2
    with Store.open(path, writable=True) as store:
        store.append(make_episode(2))
    assert_same(Store.open(path).episode(2), make_episode(2))
