"""Locks of files and folders between processes. A lock ends with its process; the file stays."""

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


def hold(descriptor: int, wait: bool = False) -> bool:
    """Takes the lock of an open file or folder; False where another process has it, unless one may `wait`.

    Raises OSError for a file system without locks, where it waits.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        if wait:
            raise
        return False
    return True


def hold_folder(folder: Path, wait: bool = False) -> int | None:
    """A descriptor that holds the lock of a folder until it is closed; None where another process has it.

    Raises OSError where there is no such folder.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if hold(descriptor, wait):
            return descriptor
    except OSError:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Holds the lock of a file; where another process has it, says so, and for whom it waits.

    Raises OSError where there can be no such file.
    """
    with path.open("a+") as file:
        if not hold(file.fileno()):
            console.print(f"waiting for {what}: {_holder(file)}")
            hold(file.fileno(), wait=True)
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
