"""Errors a person can act on: what was wrong, what was found, what is possible."""


class RfError(Exception):
    """Base of every error this project raises on purpose. Its text is shown without a traceback."""


class ArgumentError(RfError):
    """A value given by the user cannot be used (exit code 2)."""


class StageError(RfError):
    """A stage could not finish with valid arguments (exit code 1)."""


def choices(what: str, got: object, available: object) -> ArgumentError:
    """The error for a name that does not exist: names what does."""
    listed = ", ".join(sorted(str(name) for name in available))  # pyright: ignore[reportGeneralTypeIssues]
    return ArgumentError(f"unknown {what} {got!r}; available: {listed}")
