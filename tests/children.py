"""Inspection of processes, and real refusals of the operating system: file size, permissions, disk space."""

import os
import resource
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def wait_until(condition: Callable[[], object], seconds: float = 30.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def is_alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False


def session_processes(leader: int) -> list[int]:
    """Running processes of a session."""
    processes = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            fields = (path / "stat").read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            processes.append(int(path.name))
    return processes


def worker_processes(pid: int) -> list[int]:
    """Child processes that multiprocessing started as workers."""
    workers = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if b"spawn_main" in command:
            workers.append(int(child))
    return workers


@contextmanager
def small_files(limit_bytes: int) -> Iterator[None]:
    """The operating system refuses to let a file grow beyond the limit: writes raise a real OSError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def read_only(folder: Path) -> Iterator[Path]:
    """A new folder that this user cannot write to, not even as root. Skips where root may not mount."""
    folder.mkdir(0o555)
    if not os.access(folder, os.W_OK):
        yield folder
        return
    with _mounted(folder, "ro"):
        yield folder


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A new folder on a disk of `size`, in the notation of `mount`. Skips without the right to mount."""
    folder.mkdir()
    with _mounted(folder, f"size={size}"):
        yield folder


@contextmanager
def _mounted(folder: Path, options: str) -> Iterator[None]:
    result = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True)
    if result.returncode:
        pytest.skip("needs the right to mount a disk")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)
