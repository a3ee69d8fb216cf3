"""Locks of processes: a waiting process names the holder, and a lock ends with its process."""

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
def test_waiting_for_a_lock_prints_its_holder(holder, tmp_path: Path, capsys) -> None:
    events: list[str] = []

    def wait() -> None:
        with artifact_lock(tmp_path / "artifact"):
            events.append("made")

    thread = threading.Thread(target=wait)
    thread.start()
    thread.join(2.0)
    assert thread.is_alive() and not events
    holder.kill()  # the lock ends with its process
    thread.join(30.0)
    assert events == ["made"]
    output = capsys.readouterr().out
    assert f"waiting for {tmp_path / 'artifact'}: process {holder.pid} on {socket.gethostname()}" in output
    assert re.search(r"has been at work on it since \d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", output)


def test_taking_a_free_lock_prints_nothing_and_records_the_process(tmp_path: Path, capsys) -> None:
    for _ in range(2):
        with artifact_lock(tmp_path / "artifact"):
            assert f'"pid": {os.getpid()}' in (tmp_path / ".artifact.lock").read_text()
    assert capsys.readouterr().out == ""


def test_a_folder_has_one_lock_at_a_time(tmp_path: Path) -> None:
    lock = lock_folder(tmp_path)
    assert lock is not None and lock_folder(tmp_path) is None
    os.close(lock)
    second_lock = lock_folder(tmp_path)
    assert second_lock is not None
    os.close(second_lock)
    with pytest.raises(FileNotFoundError):
        lock_folder(tmp_path / "nothing")
