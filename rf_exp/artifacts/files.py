"""Files and folders that are whole whenever the process is killed, locks, and files to which lines are added.

What is written lies in a draft folder beside it, `.<name>.<random>.partial`, until it is finished and on the
disk; then one rename gives it its place. The process that writes holds a lock on the draft, which ends with
that process: a draft without one is what a kill left behind, and whoever writes into that folder next, under
whatever name, removes it.

Of things that belong together the one that counts is written around the others: it gets its place last. A
lock ends with its process; its file stays. Of lines that are added a crash leaves the last one unfinished.
"""

import errno
import fcntl
import json
import os
import shutil
import socket
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from rf_exp.errors import StageError
from rf_exp.progress import console

SYNCED_AT_ONCE = 16  # files; a disk takes many in little more time than one
RANDOM = "[0-9a-f]" * 8
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LARGEST_JSON = 2**26  # bytes


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Another place to write the file or folder `path`; it gets its own only when it is finished.

    A file that is there is replaced, a folder only where it is empty. What else is needed meanwhile may lie
    beside the draft, and goes with it. Raises OSError where nothing can be written there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    sweep(path.parent)
    folder, lock = _draft(path)
    try:
        draft = folder / path.name
        yield draft
        written = [draft, *(each for each in draft.rglob("*") if not each.is_symlink())]
        with ThreadPoolExecutor(SYNCED_AT_ONCE) as pool:
            list(pool.map(_to_disk, written))  # an error of one is raised here
        draft.replace(path)
        _to_disk(path.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def write_text(path: Path, text: str) -> None:
    """A text file in UTF-8, written whole. Raises OSError where it cannot be."""
    with whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


def keep_text(path: Path, text: str) -> None:
    """As `write_text`, but a file that says so already stays as it is."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        write_text(path, text)


def write_json(path: Path, value: object) -> None:
    """A JSON file for people to read, written whole."""
    write_text(path, json.dumps(value, indent=2) + "\n")


def disk_full(error: BaseException) -> bool:
    """Whether something could not be written for want of room. Libraries in C and Rust say so in words."""
    said = getattr(error, "errno", None) in DISK_FULL
    return said or any(os.strerror(number) in str(error) for number in DISK_FULL)


def configuration_file(artifact: Path) -> Path:
    """Beside an artifact: what it was made of."""
    return artifact.with_suffix(".configuration.json")


def read_json(path: Path, remedy: str) -> Any:
    """What is in a JSON file. Raises StageError that ends with `remedy` for one that is damaged or absent."""
    try:
        if (size := path.stat().st_size) > LARGEST_JSON:
            raise ValueError(f"{size} bytes are more than the {LARGEST_JSON} that a description may have")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise StageError(f"{path} cannot be read: {error}; {remedy}") from error
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        what = f"it holds no JSON: {error}" if content.strip(b"\0 \n") else "it is empty"
        raise StageError(f"{path} is damaged: {what}; {remedy}") from error


def sweep(folder: Path) -> None:
    """Removes drafts that a kill left in `folder`. Those of living processes stay."""
    for leftover in folder.glob(f".*.{RANDOM}.partial"):
        try:
            lock = hold_folder(leftover)
        except OSError:
            continue  # gone meanwhile
        if lock is None:
            continue  # its process lives
        shutil.rmtree(leftover, ignore_errors=True)
        os.close(lock)


def _draft(path: Path) -> tuple[Path, int]:
    while True:
        folder = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
        folder.mkdir()
        try:
            lock = hold_folder(folder, wait=True)
        except FileNotFoundError:
            continue  # swept away before it was locked
        assert lock is not None  # it has waited
        if folder.exists():
            return folder, lock
        os.close(lock)


def _to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def hold(descriptor: int, wait: bool = False) -> bool:
    """Takes the lock of an open file or folder; False, or one may `wait`, where another process has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        if wait:
            raise
        return False
    return True


def hold_folder(folder: Path, wait: bool = False) -> int | None:
    """A descriptor that holds the lock of a folder until it is closed; None where another process has it."""
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
    """Holds the lock of a file; where another process has it, says so. Raises OSError."""
    with path.open("a+") as file:
        if not hold(file.fileno()):
            file.seek(0)
            try:
                by = json.load(file)
                holder = f"process {by['pid']} on {by['host']} has been at work on it since {by['since']}"
            except (ValueError, KeyError):  # it has the lock, and has not written its name yet
                holder = "another process is at work on it"
            console.print(f"waiting for {what}: {holder}")
            hold(file.fileno(), wait=True)
        file.truncate(0)
        since = datetime.now().astimezone().isoformat(timespec="seconds")
        json.dump({"pid": os.getpid(), "host": socket.gethostname(), "since": since}, file)
        file.flush()
        yield


def append_line(path: Path, line: bytes) -> None:
    """Adds a line of JSON, durably; one that a crash left unfinished is removed first. Raises OSError.

    Any number of processes may do so to one file at a time.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a+b", buffering=0) as file:
        hold(file.fileno(), wait=True)
        size = os.fstat(file.fileno()).st_size
        if size and os.pread(file.fileno(), 1, size - 1) != b"\n":
            content = os.pread(file.fileno(), size, 0)
            tail_start = content.rfind(b"\n") + 1
            if _torn(content[tail_start:]):
                os.ftruncate(file.fileno(), tail_start)
            else:  # damaged or not, that is for the reader to say
                os.write(file.fileno(), b"\n")
        left = memoryview(line + b"\n")
        while left:  # a disk that is full takes a part, and refuses the next with its reason
            left = left[os.write(file.fileno(), left) :]
        os.fsync(file.fileno())


def read_lines(path: Path) -> tuple[list[bytes], bool]:
    """The lines of a file, and whether a crash left an unfinished one behind them. Raises OSError."""
    *lines, tail = path.read_bytes().split(b"\n")
    torn = _torn(tail) if tail else False
    return lines if torn or not tail else [*lines, tail], torn  # a whole one may lack its line end


def _torn(tail: bytes) -> bool:
    """Whether a last line without its end is the beginning of one, and not one with a damaged end."""
    for end in (len(tail), -1):
        try:
            json.loads(tail[:end])
            return False
        except ValueError:
            continue
    return True
