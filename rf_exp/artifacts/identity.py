"""What an artifact was made of, as plain JSON values: compared leaf by leaf, or by one digest."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.errors import ArgumentError


def plain(value: object) -> Any:
    """The value as it comes back from JSON: tuples as lists, numpy as plain numbers.

    Raises ArgumentError for what JSON cannot hold, NaN and infinity included.
    """

    def simplify(item: object) -> object:
        if isinstance(item, np.generic | np.ndarray):
            return item.tolist()
        if isinstance(item, Mapping):
            return dict(item)
        if isinstance(item, set | frozenset):
            return sorted(item)
        if isinstance(item, Path):
            return str(item)
        raise TypeError(f"a value of type {type(item).__name__}")

    try:
        return json.loads(json.dumps(value, default=simplify, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"an artifact is described by plain JSON values; found {error}") from error


def without(values: Mapping[str, Any], **nothing: object) -> dict[str, Any]:
    """The values but for those that say nothing: an artifact does not name what it lacks.

    So what came later, and is not used, changes no identity.
    """
    return {name: value for name, value in values.items() if name not in nothing or value != nothing[name]}


def differing(found: object, wanted: object) -> tuple[str, ...]:
    """`key: found x, wanted y` for every leaf of two nested mappings that differs, by dotted key."""
    old, new = _leaves(plain(found)), _leaves(plain(wanted))
    nothing = object()
    return tuple(
        f"{key}: found {_text(old, key)}, wanted {_text(new, key)}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key, nothing) != new.get(key, nothing)
    )


def digest(value: object) -> str:
    """SHA-256 of the value as canonical JSON, shortened to 16 hexadecimal digits."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:16]


def _text(leaves: Mapping[str, Any], key: str) -> str:
    return json.dumps(leaves[key], sort_keys=True) if key in leaves else "nothing"


def _leaves(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping) and (value or not prefix):
        return {
            key: leaf
            for name, item in value.items()
            for key, leaf in _leaves(item, f"{prefix}.{name}" if prefix else str(name)).items()
        }
    return {prefix: value}
