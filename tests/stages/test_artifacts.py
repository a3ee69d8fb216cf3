"""Artifacts record their configuration; the error for another one names all files to delete."""

import re
import shutil
from pathlib import Path

import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.stages import artifact_lock
from rf_exp.store import Store
from rf_exp.types import Pictures

ARGUMENTS = ("stages=[generate]", "task=pick_meat", "render=false", "workers=1", "recordings=0", "episodes=1")


def made(folder: Path, configuration: dict[str, object]) -> Path:
    artifact = folder / "full.jsonl"
    with artifact_lock(artifact, configuration):
        artifact.touch()
    return artifact


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is damaged: it is empty"),
        ('{"a": ', "is damaged: it holds no JSON"),
        ('{"a": 2}', "was made from another configuration (a: found 2, wanted 1)"),
        (None, "that says what it was made of is not"),
    ],
)
def test_all_files_to_delete_are_named(tmp_path: Path, content: str | None, message: str) -> None:
    artifact, record = made(tmp_path, {"a": 1}), tmp_path / "full.configuration.json"
    with artifact_lock(artifact, {"a": 1}):
        pass
    record.unlink()
    if content is not None:
        record.write_text(content)
    with pytest.raises(StageError) as caught, artifact_lock(artifact, {"a": 1}):
        pass
    assert message in str(caught.value)
    assert str(caught.value).endswith(
        f"delete {artifact}, {record}, or choose another folder with out=FOLDER"
    )


def test_a_record_without_its_artifact_is_replaced(tmp_path: Path) -> None:
    """It is left by a kill before the first row, or after somebody has deleted the rows."""
    (tmp_path / "full.configuration.json").write_text("")
    artifact = made(tmp_path, {"a": 1})
    artifact.unlink()
    made(tmp_path, {"a": 2})


@pytest.mark.slow
def test_deleting_the_named_files_helps(command, tmp_path: Path) -> None:
    assert command(*ARGUMENTS, f"out={tmp_path}").returncode == 0
    changed = (*ARGUMENTS, "limits.velocity_rad_s=0.5", f"out={tmp_path}")
    result = command(*changed)
    assert result.returncode == 1 and "limits.velocity_rad_s: found 0.9, wanted 0.5" in result.stderr
    (listed,) = re.findall(r"delete (.*), or choose another folder", result.stderr)
    for path in map(Path, listed.split(", ")):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert command(*changed).returncode == 0
    store = Store.open(tmp_path / "data/pick_meat/full/fast.zarr")
    assert store.identity["limits"]["velocity_rad_s"] == 0.5


@pytest.mark.render
@pytest.mark.slow
def test_demonstrations_with_more_cameras_are_reused(command, tmp_path: Path) -> None:
    """A store with pictures of all cameras serves requests for some of them, and not vice versa."""
    arguments = (
        "task=pick_meat",
        "stages=[generate]",
        "demos=1",
        "recordings=0",
        "workers=1",
        "wandb=disabled",
    )
    arguments += ("picture={width: 32, height: 24}",)
    for folder, first in (("some", "local"), ("whole", "all")):
        assert command(*arguments, f"cameras={first}", f"out={tmp_path / folder}").returncode == 0
    some, whole = (tmp_path / name / "data/pick_meat/full/fast.zarr" for name in ("some", "whole"))
    assert set(Store.open(some).cameras) == {"agent1"}
    assert set(Store.open(whole).cameras) == {"global", "agent1"}
    again = command(*arguments, "demos=2", "cameras=local", f"out={tmp_path / 'whole'}")
    assert again.returncode == 0
    with Store.open(whole) as store:
        assert len(store) == 2 and store.images["global"].shape[0] == store.steps
    refused = command(*arguments, "cameras=all", f"out={tmp_path / 'some'}")
    assert refused.returncode == 1 and "cameras" in refused.stderr


def test_unknown_cameras_are_refused() -> None:
    with pytest.raises(ArgumentError, match="unknown cameras 'wrist'; available: all, global, local"):
        Pictures(320, 240, render=True, cameras="wrist")  # pyright: ignore[reportArgumentType]
