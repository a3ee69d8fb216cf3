"""Files and folders that are there as a whole or not at all, whenever the process is killed.

What is written lies in a draft folder beside it, `.<name>.<random>.partial`, until it is finished and on the
disk; then one rename gives it its place. The process that writes holds a lock on the draft, which ends with
that process: a draft without one is what a kill left behind, and whoever writes into that folder next, under
whatever name, removes it.

Of things that belong together the one that counts is written around the others: it gets its place last.
"""

import errno
import json
import os
import shutil
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rf_exp.artifacts.locks import hold_folder
from rf_exp.errors import StageError

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
        _all_to_disk(draft)
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
    """A new draft folder for `path` and the lock that says that it is in use."""
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


def _all_to_disk(path: Path) -> None:
    """A file, or a folder with all that is in it."""
    with ThreadPoolExecutor(SYNCED_AT_ONCE) as pool:
        for _ in pool.map(_to_disk, [path, *(each for each in path.rglob("*") if not each.is_symlink())]):
            pass  # an error of one is raised here


def _to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
