"""Command-line arguments, checked before Hydra reads them, whose grammar errors do not help users."""

import os
import shlex
from collections.abc import Sequence
from typing import NoReturn

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from rf_exp.errors import ArgumentError
from rf_exp.installed import CONF

EXCLUSIVE_FLAGS = {
    "run": "--run",
    "multirun": "--multirun",
    "cfg": "--cfg",
    "info": "--info",
}  # mutually exclusive

TILDE_HINT = "in the place of ~ the shell has not put your home; write $HOME"


def checked_arguments(arguments: Sequence[str]) -> list[str]:
    """The arguments with Hydra's flags first. Raises ArgumentError for flags and values it cannot take."""
    parser = get_args_parser()
    parser.error = _refuse_flags  # pyright: ignore[reportAttributeAccessIssue]
    parsed = parser.parse_intermixed_args(list(arguments))
    if parsed.shell_completion:  # its arguments come from the shell
        return list(arguments)
    exclusive = [flag for name, flag in EXCLUSIVE_FLAGS.items() if getattr(parsed, name)]
    if len(exclusive) > 1:
        _refuse_flags(f"{' and '.join(exclusive)} are given, which are two ways to go; leave one of them out")
    if parsed.resolve and not parsed.cfg and not parsed.help:
        _refuse_flags("--resolve is given, which goes with --cfg")
    if parsed.experimental_rerun:
        raise ArgumentError(
            "--experimental-rerun reads a pickle, which could run any code; what was said of a job is in "
            "runs/*/*/.hydra/overrides.yaml, to be said again"
        )
    for override in parsed.overrides:
        _check_override(override)
    pending = list(parsed.overrides)
    flags = [word for word in arguments if not (pending and word == pending[0] and pending.pop(0))]
    return flags + parsed.overrides


def checked_folder(value: object) -> str:
    """The folder as given. Raises ArgumentError for a value that would make an unintended folder."""
    if not isinstance(value, str) or not value.strip():
        raise ArgumentError(f"out is {value!r}; expected the name of a folder, in quotes if it is a number")
    for culprit, why in (
        (value.startswith("~") and "~", TILDE_HINT),
        ("$" in value and "$", "the shell puts a variable there only outside of single quotes"),
        (os.sep != "\\" and "\\" in value and "\\", "folders are separated by /"),
        (next((letter for letter in value if not letter.isprintable()), False), "it cannot be seen"),
    ):
        if culprit:
            raise ArgumentError(
                f"out is {value!r}, and {culprit!r} would be part of the folder's name; {why}"
            )
    return value


def _refuse_flags(message: str) -> NoReturn:
    raise ArgumentError(f"{message}; --hydra-help says which flags there are")


def _check_override(override: str) -> None:
    """Raises ArgumentError for an override outside of Hydra's grammar, with how to write it."""
    key, equals, value = override.partition("=")
    error = _grammar_error(override)
    if error is None and key.lstrip("+~"):
        if value == "null" and (CONF / key).is_dir():
            raise ArgumentError(
                f"{override!r}: {key} is chosen among files; choose one, or none with '~{key}'"
            )
        return
    if override != override.rstrip("\r\n"):
        raise ArgumentError(
            f"{override!r} ends with a carriage return, as the lines of a script do that was written on "
            "Windows; save it with the ends of lines of Unix"
        )
    if not key.lstrip("+~") or not (equals or key.startswith("~")):
        raise ArgumentError(f"{override!r} is not understood; expected key=value, or a flag such as --help")
    if value.startswith("~"):
        raise ArgumentError(f"{override!r} is not understood: {TILDE_HINT}")
    if value.startswith(("[", "{")):
        raise ArgumentError(
            f"{override!r} is not understood; expected a list as in '{key}=[a, b]', or a mapping as in "
            f"'{key}={{a: 1, b: 2}}', in quotes for the shell where spaces are in it ({error})"
        )
    if (
        whitespace := next((letter for letter in value if letter.isspace() and letter != " "), None)
    ) is not None:
        raise ArgumentError(
            f"{override!r} is not understood: {whitespace!r} looks like a space and is none; write one, in "
            "quotes that the shell leaves, or nothing"
        )
    special = next((letter for letter in value if _grammar_error(f"{key}=a{letter}a") is not None), None)
    quoted = f'{key}="{value}"' if '"' not in value else f"{key}='{value}'"
    if special is None or _grammar_error(quoted) is not None:
        raise ArgumentError(f"{override!r} is not understood ({error})")
    raise ArgumentError(
        f"{override!r} is not understood: {special!r} needs quotes that the shell leaves, "
        f"as in {shlex.quote(quoted)}"
    )


def _grammar_error(override: str) -> str | None:
    """Hydra's error about an override, in one line; None if there is none."""
    try:
        OverridesParser.create().parse_override(override)
    except HydraException as error:
        return str(error).splitlines()[0]
    return None
