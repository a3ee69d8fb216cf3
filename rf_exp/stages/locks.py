"""Locks that say who holds them. A lock ends with the process that holds it; its file stays."""

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TextIO

from rf_exp.progress import console


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Holds the lock of a file; where another process has it, says so, and for whom it waits.

    Raises OSError where there can be no such file.
    """
    with path.open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            console.print(f"waiting for {what}: {_holder(file)}")
            fcntl.flock(file, fcntl.LOCK_EX)
        file.truncate(0)
        since = datetime.now().astimezone().isoformat(timespec="seconds")
        json.dump({"pid": os.getpid(), "host": socket.gethostname(), "since": since}, file)
        file.flush()
        yield


def _holder(file: TextIO) -> str:
    try:
        file.seek(0)
        found = json.load(file)
        return f"process {found['pid']} on {found['host']} has been at work on it since {found['since']}"
    except (ValueError, KeyError):  # it has the lock, and has not written its name yet
        return "another process is at work on it"
