"""Errors that users can act on: what was wrong, what was found, what is possible."""

import errno
import pickle
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rf_exp.texts import LONGEST_ERROR, one_line

ACCESS_ERRORS = (errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class RfError(Exception):
    """Base class of every error that this project raises on purpose; shown without a traceback.

    Its text is one line, also where it quotes text from outside: see `rf_exp.texts`.
    """

    def __init__(self, *arguments: object) -> None:
        super().__init__(
            *(
                one_line(argument, LONGEST_ERROR) if isinstance(argument, str) else argument
                for argument in arguments
            )
        )


class ArgumentError(RfError):
    """A value given by the user cannot be used (exit code 2)."""


class StageError(RfError):
    """A stage could not finish with valid arguments (exit code 1)."""


class WorkerDied(StageError):
    """A worker process died during its job; the same job may succeed in another process."""


def unknown_choice(kind: str, value: object, available: object) -> ArgumentError:
    """The error for an unknown name; lists the available ones."""
    listed = ", ".join(sorted(str(name) for name in available))  # pyright: ignore[reportGeneralTypeIssues]
    return ArgumentError(f"unknown {kind} {value!r}; available: {listed}")


def refuse_access(path: Path, error: Exception) -> None:
    """Raises StageError if the system (permissions, limits, memory) keeps `path` from being read."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in ACCESS_ERRORS):
        reason = (error.strerror if isinstance(error, OSError) else None) or "memory ran out"
        raise StageError(
            f"{path} cannot be read now: {reason}; nothing is known to be wrong with it: see to that, "
            "and run the same command again"
        ) from error


@contextmanager
def error_context(prefix: str) -> Iterator[None]:
    """Context that puts `prefix` in front of the message of an RfError."""
    try:
        yield
    except RfError as error:
        error.args = (f"{prefix}: {error}",)
        raise


def picklable_error(error: Exception) -> Exception:
    """The error of a worker in a form that can be pickled, with its traceback as a note."""
    details = "".join(traceback.format_exception(error))
    try:
        error.add_note(f"in a worker:\n{details}")
        return pickle.loads(pickle.dumps(error))
    except Exception:  # unpickling may raise anything
        stand_in = RuntimeError(f"{type(error).__name__}: {error}")
        stand_in.add_note(f"in a worker:\n{details}")
        return stand_in
