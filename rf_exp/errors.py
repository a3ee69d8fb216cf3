"""Errors that users can act on: what was wrong, what was found, what is possible."""

import errno
import pickle
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rf_exp.texts import LONGEST_ERROR, one_line

REFUSED = (errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class RfError(Exception):
    """Base class of every error that this project raises on purpose; shown without a traceback.

    Its text is one line, also where it quotes text from outside: see `rf_exp.texts`.
    """

    def __init__(self, *told: object) -> None:
        super().__init__(*(one_line(each, LONGEST_ERROR) if isinstance(each, str) else each for each in told))


class ArgumentError(RfError):
    """A value given by the user cannot be used (exit code 2)."""


class StageError(RfError):
    """A stage could not finish with valid arguments (exit code 1)."""


class WorkerDied(StageError):
    """A worker process died during its job; the same job may succeed in another process."""


def choices(what: str, got: object, available: object) -> ArgumentError:
    """The error for an unknown name; lists the available ones."""
    listed = ", ".join(sorted(str(name) for name in available))  # pyright: ignore[reportGeneralTypeIssues]
    return ArgumentError(f"unknown {what} {got!r}; available: {listed}")


def refuse_access(path: Path, error: Exception) -> None:
    """Raises StageError if the system (permissions, limits, memory) keeps `path` from being read."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in REFUSED):
        why = (error.strerror if isinstance(error, OSError) else None) or "memory ran out"
        raise StageError(
            f"{path} cannot be read now: {why}; nothing is known to be wrong with it: see to that, "
            "and run the same command again"
        ) from error


@contextmanager
def about(what: str) -> Iterator[None]:
    """Context that puts `what` in front of the message of an RfError."""
    try:
        yield
    except RfError as error:
        error.args = (f"{what}: {error}",)
        raise


def portable(error: Exception) -> Exception:
    """The error of a worker in a form that can be pickled, with its traceback as a note."""
    told = "".join(traceback.format_exception(error))
    try:
        error.add_note(f"in a worker:\n{told}")
        return pickle.loads(pickle.dumps(error))
    except Exception:  # unpickling may raise anything
        stand_in = RuntimeError(f"{type(error).__name__}: {error}")
        stand_in.add_note(f"in a worker:\n{told}")
        return stand_in
