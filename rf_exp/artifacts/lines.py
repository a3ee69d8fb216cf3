"""Files to which lines are added, each durably; whatever a crash leaves unfinished is the last line."""

import json
import os
from pathlib import Path

from rf_exp.artifacts.locks import hold


def append_line(path: Path, line: bytes) -> None:
    """Adds a line of JSON, durably. Any number of processes may do so to one file at a time.

    A line that a crash left unfinished is removed first. Raises OSError when the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a+b", buffering=0) as file:
        hold(file.fileno(), wait=True)
        _mend(file.fileno())
        left = memoryview(line + b"\n")
        while left:  # a disk that is full takes a part, and refuses the next with its reason
            left = left[os.write(file.fileno(), left) :]
        os.fsync(file.fileno())


def read_lines(path: Path) -> tuple[list[bytes], bool]:
    """The lines of a file, and whether behind them is one that a crash left unfinished.

    Raises OSError when it cannot be read.
    """
    *lines, tail = path.read_bytes().split(b"\n")
    torn = _torn(tail) if tail else False
    return lines if torn or not tail else [*lines, tail], torn  # a whole one may lack its line end


def _torn(tail: bytes) -> bool:
    """Whether a last line without its end is the beginning of one, and not a whole one with a damaged end."""
    for end in (len(tail), -1):
        try:
            json.loads(tail[:end])
            return False
        except ValueError:
            continue
    return True


def _mend(descriptor: int) -> None:
    """Finish or remove a last line without its end. The lock is held, so nobody is writing it."""
    size = os.fstat(descriptor).st_size
    if size == 0 or os.pread(descriptor, 1, size - 1) == b"\n":
        return
    content = os.pread(descriptor, size, 0)
    tail_start = content.rfind(b"\n") + 1
    if _torn(content[tail_start:]):
        os.ftruncate(descriptor, tail_start)
    else:  # damaged or not, that is for the reader to say
        os.write(descriptor, b"\n")
