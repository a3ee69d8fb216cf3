"""Rescue of damaged stores: intact episodes are kept bit by bit, the damaged store is never changed."""

import hashlib
import sys
from pathlib import Path

import pytest
import zarr

from rf_exp.command import run_guarded
from rf_exp.errors import StageError
from rf_exp.rescue import main
from rf_exp.store import Store
from tests.store.episodes import assert_same, make_episode, make_store

EPISODES = [make_episode(seed, 100) for seed in range(6)]  # files of 256 rows hold episodes 0-2, 2-5 and 5


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "quick.zarr", EPISODES)


@pytest.fixture
def rescue(monkeypatch, capsys):
    """The command in this process: exit code, standard output, standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp.rescue", *map(str, arguments)])
        capsys.readouterr()
        return run_guarded(main), *capsys.readouterr()

    return call


def digest(folder: Path) -> str:
    sha = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        sha.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return sha.hexdigest()


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0x10
    path.write_bytes(content)


DAMAGES = {  # damage -> (function that causes it, seeds that are kept)
    "a picture file is missing": (lambda p: (p / "data/rgb_agent1/c/1/0/0/0").unlink(), [0, 1]),
    "the metadata of an array is cut": (
        lambda p: (p / "data/qpos/zarr.json").write_text("{"),
        list(range(6)),
    ),
    "the ends' metadata is lost": (lambda p: (p / "meta/episode_ends/zarr.json").unlink(), list(range(6))),
    "the seeds are lost": (lambda p: (p / "meta/seed/c/0").unlink(), []),
    "a bit of the joints is flipped": (lambda p: flip(p / "data/qpos/c/0/0/0"), [0, 3, 4, 5]),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_intact_episodes_are_kept_and_the_damaged_store_is_moved_aside(
    path: Path, rescue, damage: str
) -> None:
    attributes = dict(zarr.open_group(path, mode="r").attrs)
    damage_store, kept = DAMAGES[damage]
    damage_store(path)
    with pytest.raises(StageError, match=r"python -m rf_exp\.rescue"):
        Store.open(path)
    before = digest(path)
    code, out, errors = rescue(path)
    assert (code, errors) == (0, "")
    assert f"holds the {len(kept)} whole episodes of 6" in out
    store = Store.open(path)
    assert store.seeds.tolist() == kept
    for index, seed in enumerate(kept):
        assert_same(store.episode(index), EPISODES[seed])
    assert store.attrs == attributes
    assert digest(path.with_name("quick.damaged.zarr")) == before
    assert out.count("lost: episode") == 6 - len(kept)
    assert {each.name for each in path.parent.iterdir() if not each.name.endswith(".lock")} == {
        "quick.zarr",
        "quick.damaged.zarr",
    }


@pytest.mark.slow
def test_a_flipped_bit_in_a_picture_loses_its_episode_only(path: Path, rescue) -> None:
    flip(path / "data/rgb_global/c/0/0/0/0")
    code, out, _ = rescue(path)
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.startswith("lost")]
    assert line.startswith("lost: episode 0, seed 0: data/rgb_global cannot be read: ")
    assert Store.open(path).seeds.tolist() == [1, 2, 3, 4, 5]


@pytest.mark.slow
def test_a_dry_run_reports_what_would_be_kept_and_changes_nothing(path: Path, rescue) -> None:
    (path / "data/rgb_agent1/c/1/0/0/0").unlink()
    before = digest(path.parent)
    code, out, _ = rescue(path, "--dry-run")
    assert code == 0 and "2 of 6 episodes can be kept; nothing was changed" in out
    assert digest(path.parent) == before
    assert {each.name for each in path.parent.iterdir()} == {"quick.zarr"}


@pytest.mark.slow
def test_an_intact_store_is_unchanged(path: Path, rescue) -> None:
    before = digest(path)
    code, out, _ = rescue(path)
    assert code == 0 and "is not damaged: all 6 episodes can be read" in out
    assert digest(path) == before
    assert not path.with_name("quick.damaged.zarr").exists()


@pytest.mark.slow
def test_a_killed_rescue_is_completed(path: Path, rescue) -> None:
    path.with_name("quick.rescued.zarr").mkdir()  # killed during writing
    (path / "data/qpos/zarr.json").unlink()
    assert rescue(path)[0] == 0
    path.rename(path.with_name("quick.rescued.zarr"))  # killed between the two moves
    code, out, _ = rescue(path)
    assert code == 0 and "is the rescued one now" in out
    assert len(Store.open(path)) == 6


def test_the_reason_is_given_if_nothing_can_be_rescued(path: Path, rescue, tmp_path: Path) -> None:
    code, _, errors = rescue(tmp_path / "nothing.zarr")
    assert code == 1 and "no store at" in errors
    (path / "zarr.json").write_text("{")
    before = digest(path)
    code, _, errors = rescue(path)
    assert code == 1 and "has no attributes that can be read" in errors
    assert digest(path) == before


@pytest.mark.slow
def test_an_earlier_damaged_store_is_not_overwritten(path: Path, rescue) -> None:
    flip(path / "data/rgb_global/c/0/0/0/0")
    first, second = (path.with_name(f"quick.damaged{number}.zarr") for number in ("", "-2"))
    assert rescue(path)[0] == 0
    original = digest(first)
    code, out, errors = rescue(path)
    assert (code, errors) == (0, "") and "is not damaged: all 5 episodes can be read" in out
    assert digest(first) == original and not second.exists()
    flip(path / "data/rgb_agent1/c/1/0/0/0")
    second_damage = digest(path)
    assert rescue(path)[0] == 0
    assert (digest(first), digest(second)) == (original, second_damage)
    assert Store.open(path).seeds.tolist() == [1, 2, 3, 5]


@pytest.mark.slow
def test_a_dry_run_does_not_complete_a_killed_rescue(path: Path, rescue) -> None:
    path.with_name("quick.damaged.zarr").mkdir()
    path.rename(path.with_name("quick.rescued.zarr"))
    code, out, _ = rescue(path, "--dry-run")
    assert code == 0 and "would be the rescued one now" in out
    assert not path.exists()
