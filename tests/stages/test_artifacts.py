"""Artifacts know what they were made of, and the message about another says what really helps."""

import re
import shutil
from pathlib import Path

import pytest

from rf_exp.errors import StageError
from rf_exp.stages.artifacts import owned
from rf_exp.store import Store

ARGUMENTS = ("stages=[generate]", "task=pick_meat", "render=false", "workers=1", "recordings=0", "episodes=1")


def made(folder: Path, configuration: dict[str, object]) -> Path:
    artifact = folder / "full.jsonl"
    with owned(artifact, configuration):
        artifact.touch()
    return artifact


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is damaged: it is empty"),
        ('{"a": ', "is damaged: it holds no JSON"),
        ('{"a": 2}', "was made with another configuration (a: found 2, wanted 1)"),
        (None, "that says what it was made of is not"),
    ],
)
def test_all_that_has_to_go_is_named(tmp_path: Path, content: str | None, message: str) -> None:
    artifact, record = made(tmp_path, {"a": 1}), tmp_path / "full.configuration.json"
    with owned(artifact, {"a": 1}):
        pass
    record.unlink()
    if content is not None:
        record.write_text(content)
    with pytest.raises(StageError) as caught, owned(artifact, {"a": 1}):
        pass
    assert message in str(caught.value)
    assert str(caught.value).endswith(
        f"delete {artifact}, {record}, or choose another folder with out=FOLDER"
    )


def test_a_record_without_its_artifact_is_of_nothing(tmp_path: Path) -> None:
    """Left by a kill before the first row, or when somebody has deleted the rows."""
    (tmp_path / "full.configuration.json").write_text("")
    artifact = made(tmp_path, {"a": 1})
    artifact.unlink()
    made(tmp_path, {"a": 2})


@pytest.mark.slow
def test_deleting_what_is_named_helps(command, tmp_path: Path) -> None:
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
