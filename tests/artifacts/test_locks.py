"""Locks that processes hold: who waits says so, and for whom; the lock ends with its process."""

import os
import re
import socket
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from rf_exp.artifacts import lock_folder
from rf_exp.stages import artifact_lock

HOLD = """
    import sys, time
    from pathlib import Path
    from rf_exp.artifacts import locked
    with locked(Path(sys.argv[1]), "it"):
        print("held", flush=True)
        time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of `artifact`."""
    command = [sys.executable, "-c", textwrap.dedent(HOLD), str(tmp_path / ".artifact.lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        yield process
        process.kill()


@pytest.mark.slow
def test_who_waits_for_a_lock_says_so_and_for_whom(holder, tmp_path: Path, capsys) -> None:
    said: list[str] = []

    def wait() -> None:
        with artifact_lock(tmp_path / "artifact"):
            said.append("made")

    waiting = threading.Thread(target=wait)
    waiting.start()
    waiting.join(2.0)
    assert waiting.is_alive() and not said
    holder.kill()  # the lock ends with its process
    waiting.join(30.0)
    assert said == ["made"]
    words = capsys.readouterr().out
    assert f"waiting for {tmp_path / 'artifact'}: process {holder.pid} on {socket.gethostname()}" in words
    assert re.search(r"has been at work on it since \d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", words)


def test_who_does_not_wait_says_nothing_and_writes_its_name(tmp_path: Path, capsys) -> None:
    for _ in range(2):
        with artifact_lock(tmp_path / "artifact"):
            assert f'"pid": {os.getpid()}' in (tmp_path / ".artifact.lock").read_text()
    assert capsys.readouterr().out == ""


def test_a_folder_is_held_by_one_at_a_time(tmp_path: Path) -> None:
    held = lock_folder(tmp_path)
    assert held is not None and lock_folder(tmp_path) is None
    os.close(held)
    again = lock_folder(tmp_path)
    assert again is not None
    os.close(again)
    with pytest.raises(FileNotFoundError):
        lock_folder(tmp_path / "nothing")
