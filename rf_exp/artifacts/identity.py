"""Provenance of artifacts: configurations as plain JSON values and back, their comparison, code versions."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar, get_origin

import dacite

from rf_exp.errors import ArgumentError, StageError

CHECKOUT = Path(__file__).resolve().parents[2]

T = TypeVar("T")


def plain(value: object) -> Any:
    """The value as it comes back from JSON: dataclasses as objects, tuples and arrays as lists.

    Raises ArgumentError for what JSON cannot hold, NaN and infinity included.
    """
    try:
        return json.loads(json.dumps(value, default=_jsonable, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"an artifact is described by plain JSON values; found {error}") from error


def restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """The dataclass of which `plain` made these values; fields added since then have their defaults.

    Raises ArgumentError naming a field that is missing, unknown or of another type.
    """
    if not isinstance(values, Mapping):
        raise ArgumentError(f"a {kind.__name__} is {values!r}; expected an object")
    try:
        return dacite.from_dict(kind, values, dacite.Config(cast=[tuple, float, Enum], strict=True))
    except (dacite.DaciteError, TypeError) as error:
        raise ArgumentError(str(error)) from error


def read_values(kind: type[T], values: Mapping[str, Any], within: str = "") -> T:
    """A dataclass from the values of a configuration; nested dataclasses may be instances already.

    Raises ArgumentError naming the invalid dotted key, which begins with `within`.
    """
    if not isinstance(values, Mapping):
        raise ArgumentError(f"{within.rstrip('.')} is {values!r}; expected keys below it")
    try:
        _expect_lists(kind, values, within)
        return dacite.from_dict(kind, values, dacite.Config(cast=[tuple, float], strict=True))
    except dacite.WrongTypeError as error:
        wanted = getattr(error.field_type, "__name__", None) if isinstance(error.field_type, type) else None
        expected = wanted or error.field_type
        raise ArgumentError(f"{within}{error.field_path} is {error.value!r}; expected {expected}") from error
    except (dacite.DaciteError, TypeError) as error:
        raise ArgumentError(f"{within.rstrip('.') or 'configuration'}: {error}") from error


def _expect_lists(kind: Any, values: Mapping[str, Any], within: str) -> None:
    """Raises ArgumentError for a single value in a tuple field: a string would become its letters."""
    for field in fields(kind):
        if field.name not in values:
            continue
        key, value = within + field.name, values[field.name]
        if is_dataclass(field.type) and isinstance(value, Mapping):
            _expect_lists(field.type, value, f"{key}.")
        many = isinstance(value, Sequence) and not isinstance(value, str)
        if get_origin(field.type) is tuple and not many:
            raise ArgumentError(f"{key} is {value!r}; expected a list: {key}=[...]")


def canonical(value: object, ascii: bool = False) -> bytes:
    """Plain values as canonical JSON: keys sorted, no spaces; UTF-8, or escaped to ASCII."""
    text = json.dumps(value, ensure_ascii=ascii, sort_keys=True, separators=(",", ":"))
    return text.encode(errors="surrogatepass")


def digest(value: object) -> str:
    """SHA-256 of the value as canonical JSON, shortened to 16 hexadecimal digits."""
    return hashlib.sha256(canonical(plain(value), ascii=True)).hexdigest()[:16]


def drop_defaults(values: Mapping[str, Any], **defaults: object) -> dict[str, Any]:
    """The values but for those equal to their entry in `defaults`: unused new keys change no identity."""
    return {name: value for name, value in values.items() if name not in defaults or value != defaults[name]}


def leaves(value: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted key, beginning with `prefix`, -> value in nested mappings."""
    if isinstance(value, Mapping) and (value or not prefix):
        return {
            key: leaf
            for name, item in value.items()
            for key, leaf in leaves(item, f"{prefix}.{name}" if prefix else str(name)).items()
        }
    return {prefix: value}


def find_differences(found: object, wanted: object) -> tuple[str, ...]:
    """`key: found x, wanted y` for every leaf of two nested mappings that differs, by dotted key."""
    old, new = leaves(plain(found)), leaves(plain(wanted))
    missing = object()
    return tuple(
        f"{key}: found {_leaf_text(old, key)}, wanted {_leaf_text(new, key)}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key, missing) != new.get(key, missing)
    )


def expect_same(artifact: Path, found: object, wanted: object, remedy: str) -> None:
    """Raises StageError, naming the differences and ending with `remedy`, unless `found` is as `wanted`."""
    if differences := find_differences(found, wanted):
        raise StageError(
            f"{artifact} was made from another configuration ({'; '.join(differences)}); {remedy}"
        )


def _jsonable(item: object) -> object:
    if is_dataclass(item) and not isinstance(item, type):
        return {field.name: getattr(item, field.name) for field in fields(item)}
    if callable(tolist := getattr(item, "tolist", None)):  # NumPy values; --help does not import NumPy
        return tolist()
    if isinstance(item, Mapping):
        return dict(item)
    if isinstance(item, set | frozenset):
        return sorted(item)
    if isinstance(item, Path):
        return str(item)
    raise TypeError(f"a value of type {type(item).__name__}")


def _leaf_text(leaves: Mapping[str, Any], key: str) -> str:
    return json.dumps(leaves[key], sort_keys=True) if key in leaves else "nothing"


@cache
def commit(checkout: Path = CHECKOUT) -> str:
    """The git commit of the code, with a + where files were changed since; empty where git gives none."""
    if not (checkout / ".git").exists():  # installed; a repository further up is not ours
        return ""
    command = ["git", "--no-optional-locks", "-C", str(checkout), "describe"]
    command += ["--always", "--exclude=*", "--abbrev=12", "--dirty=+"]
    # Within a hook of git these variables would name another repository.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, timeout=30
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return result.stdout.strip()


def code_version(checkout: Path = CHECKOUT) -> str:
    """Version of the code, as recorded in artifacts: its commit or, without a checkout, its release."""
    return commit(checkout) or f"rf_exp-{package_versions(['rf_exp']).get('rf_exp', 'unknown')}"


def package_versions(packages: Iterable[str]) -> dict[str, str]:
    """The version of Python and of those packages that are installed."""
    versions = {"python": platform.python_version()}
    for package in packages:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue  # not every machine has the simulator
    return versions
