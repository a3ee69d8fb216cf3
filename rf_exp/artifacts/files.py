"""Atomic writing of files and folders, locks, and files to which lines are appended.

A draft lies in a folder beside its target, `.<name>.<random>.partial`, until it is finished and synced to
disk; then it is renamed. The writing process holds a lock on the draft, which ends with the process: a draft
without a lock was left by a killed process, and the next write to that folder, under any name, removes it.

Of artifacts that belong together, the one that marks completion is written around the others, so that it is
renamed last. A lock ends with its process; its file stays. A crash leaves an appended line unfinished.
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

SYNC_THREADS = 16  # files; syncing many takes little longer than one
RANDOM_SUFFIX = "[0-9a-f]" * 8
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LARGEST_JSON = 2**26  # bytes


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yields a draft path at which to write the file or folder `path`; it is renamed when finished.

    An existing file is replaced, an existing folder only if empty. Temporary files may lie beside the draft
    and are removed with it. Raises OSError where nothing can be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_stale_drafts(path.parent)
    folder, lock = _draft(path)
    try:
        draft = folder / path.name
        yield draft
        paths = [draft, *(child for child in draft.rglob("*") if not child.is_symlink())]
        with ThreadPoolExecutor(SYNC_THREADS) as pool:
            list(pool.map(_fsync, paths))  # raises their errors
        draft.replace(path)
        _fsync(path.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def write_text(path: Path, text: str) -> None:
    """Writes a UTF-8 text file atomically. Raises OSError."""
    with atomic_path(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_text_if_changed(path: Path, text: str) -> None:
    """As `write_text`, but a file with the same text is left untouched."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        write_text(path, text)


def write_json(path: Path, value: object) -> None:
    """Writes an indented JSON file atomically."""
    write_text(path, json.dumps(value, indent=2) + "\n")


def disk_full(error: BaseException) -> bool:
    """Whether an error means that the disk is full. Libraries in C and Rust report it only as text."""
    known_errno = getattr(error, "errno", None) in DISK_FULL
    return known_errno or any(os.strerror(number) in str(error) for number in DISK_FULL)


def configuration_file(artifact: Path) -> Path:
    """Path of the file beside an artifact that holds its configuration."""
    return artifact.with_suffix(".configuration.json")


def read_json(path: Path, remedy: str) -> Any:
    """Reads a JSON file. Raises StageError, ending with `remedy`, if it is damaged, too large or absent."""
    try:
        if (size := path.stat().st_size) > LARGEST_JSON:
            raise ValueError(f"{size} bytes are more than the {LARGEST_JSON} that a description may have")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise StageError(f"{path} cannot be read: {error}; {remedy}") from error
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        problem = f"it holds no JSON: {error}" if content.strip(b"\0 \n") else "it is empty"
        raise StageError(f"{path} is damaged: {problem}; {remedy}") from error


def remove_stale_drafts(folder: Path) -> None:
    """Removes drafts that killed processes left in `folder`. Those of living processes stay."""
    for leftover in folder.glob(f".*.{RANDOM_SUFFIX}.partial"):
        try:
            lock = lock_folder(leftover)
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
            lock = lock_folder(folder, wait=True)
        except FileNotFoundError:
            continue  # swept away before it was locked
        assert lock is not None  # it waits for the lock
        if folder.exists():
            return folder, lock
        os.close(lock)


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def acquire_lock(descriptor: int, wait: bool = False) -> bool:
    """Takes the lock of an open file or folder; where another process has it, waits or returns False."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        if wait:
            raise
        return False
    return True


def lock_folder(folder: Path, wait: bool = False) -> int | None:
    """A descriptor that holds the lock of a folder until it is closed; None where another process has it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if acquire_lock(descriptor, wait):
            return descriptor
    except OSError:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Holds the lock of a file; prints a message while another process has it. Raises OSError."""
    with path.open("a+") as file:
        if not acquire_lock(file.fileno()):
            file.seek(0)
            try:
                owner = json.load(file)
                holder = (
                    f"process {owner['pid']} on {owner['host']} has been at work on it since {owner['since']}"
                )
            except (ValueError, KeyError):  # the holder has not written its name yet
                holder = "another process is at work on it"
            console.print(f"waiting for {what}: {holder}")
            acquire_lock(file.fileno(), wait=True)
        file.truncate(0)
        since = datetime.now().astimezone().isoformat(timespec="seconds")
        json.dump({"pid": os.getpid(), "host": socket.gethostname(), "since": since}, file)
        file.flush()
        yield


def append_line(path: Path, line: bytes) -> None:
    """Appends a line of JSON, durably; removes a line that a crash left unfinished. Raises OSError.

    Several processes may append to one file at the same time.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a+b", buffering=0) as file:
        acquire_lock(file.fileno(), wait=True)
        size = os.fstat(file.fileno()).st_size
        if size and os.pread(file.fileno(), 1, size - 1) != b"\n":
            content = os.pread(file.fileno(), size, 0)
            tail_start = content.rfind(b"\n") + 1
            if _torn(content[tail_start:]):
                os.ftruncate(file.fileno(), tail_start)
            else:  # complete or damaged: the reader decides
                os.write(file.fileno(), b"\n")
        remaining = memoryview(line + b"\n")
        while remaining:  # a full disk may take a part; the next write raises
            remaining = remaining[os.write(file.fileno(), remaining) :]
        os.fsync(file.fileno())


def read_lines(path: Path) -> tuple[list[bytes], bool]:
    """The complete lines of a file, and whether an unfinished one follows them. Raises OSError."""
    *lines, tail = path.read_bytes().split(b"\n")
    torn = _torn(tail) if tail else False
    return lines if torn or not tail else [*lines, tail], torn  # a complete one may lack its line end


def _torn(tail: bytes) -> bool:
    """Whether a last line without a line end is unfinished, not complete with a missing or damaged end."""
    for end in (len(tail), -1):
        try:
            json.loads(tail[:end])
            return False
        except ValueError:
            continue
    return True
