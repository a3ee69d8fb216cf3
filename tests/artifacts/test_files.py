"""Atomic writes: a file is complete or absent, and drafts of ended processes are removed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rf_exp.artifacts import atomic_path, read_json, remove_stale_drafts, write_json
from rf_exp.errors import StageError

WRITER = """
import sys, time
from pathlib import Path
from rf_exp.artifacts.files import atomic_path
with atomic_path(Path(sys.argv[1])) as draft:
    draft.write_text("half")
    print("writing", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def writer(tmp_path: Path):
    """A process in the middle of writing `tmp_path / "model.bin"`."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "model.bin")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "writing\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def drafts(folder: Path) -> list[Path]:
    return list(folder.glob(".*"))


def test_a_file_appears_once_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "new/folder/model.bin"
    with atomic_path(path) as draft:
        draft.write_text("whole")
        assert not path.exists() and draft.name == path.name
    assert path.read_text() == "whole"
    assert os.listdir(path.parent) == ["model.bin"]


def test_the_old_file_is_kept_if_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "model.bin"
    path.write_text("before")
    with pytest.raises(RuntimeError), atomic_path(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert path.read_text() == "before"
    assert not drafts(tmp_path)


def test_a_folder_can_be_written_too(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "store") as draft:
        draft.mkdir()
        (draft / "one").write_text("1")
    assert (tmp_path / "store/one").read_text() == "1"


def test_only_drafts_of_ended_processes_are_removed(tmp_path: Path, writer) -> None:
    remove_stale_drafts(tmp_path)
    (draft,) = drafts(tmp_path)
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    assert drafts(tmp_path) == [draft]
    foreign_draft = tmp_path / ".download.of-another-program.partial"
    foreign_draft.mkdir()
    remove_stale_drafts(tmp_path)
    assert drafts(tmp_path) == [foreign_draft]


def test_writing_another_file_removes_drafts_of_ended_processes(tmp_path: Path, writer) -> None:
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    write_json(tmp_path / "another.json", {})
    assert not drafts(tmp_path)


def test_the_next_writer_removes_only_drafts_of_ended_processes(tmp_path: Path, writer) -> None:
    with atomic_path(tmp_path / "model.bin") as draft:
        draft.write_text("whole")
    assert (tmp_path / "model.bin").read_text() == "whole"
    assert len(drafts(tmp_path)) == 1  # of the running process
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    with atomic_path(tmp_path / "model.bin") as draft:
        draft.write_text("again")
    assert not drafts(tmp_path)


def test_json_is_read_as_written(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"x": [1, 2.5, None]})
    assert read_json(tmp_path / "a.json", "") == {"x": [1, 2.5, None]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"a\.json is damaged: it is empty; delete it"),
        (b"\0\0\0", r"a\.json is damaged: it is empty; delete it"),
        (b'{"x": 1', r"a\.json is damaged: it holds no JSON: .*; delete it"),
        (b'{"x": "\xff"}', r"a\.json is damaged: it holds no JSON: .*; delete it"),
    ],
)
def test_damaged_json_is_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(StageError, match=message):
        read_json(tmp_path / "a.json", "delete it")
