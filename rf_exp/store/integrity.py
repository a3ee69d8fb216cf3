"""Whether a store is whole: attributes, layout, shapes, types, ends, seeds, and that every file answers."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.errors import RfError, StageError
from rf_exp.store.layout import READABLE, array_of, file_of, layout, rows_a_file
from rf_exp.types import CONTROL_HZ

ATTRIBUTES = {"format", "task", "identity", "agents", "cameras", "height", "width", "control_hz"}


@contextmanager
def blames(path: Path, what: str) -> Iterator[None]:
    """Turns whatever a decoder raises on damaged bytes into a StageError that names the array."""
    try:
        yield
    except RfError:
        raise
    except Exception as error:
        raise damaged(path, f"{what} ({type(error).__name__}: {error})") from error


def damaged(path: Path, what: str) -> StageError:
    return StageError(
        f"{path} is damaged: {what}; restore it from a copy, keep what is "
        f"whole with `python -m rf_exp.rescue {path}`, or delete it and generate again"
    )


def check_attributes(path: Path, attributes: Mapping[str, Any]) -> None:
    """Raises StageError for attributes that are missing, or of another format."""
    if missing := sorted(ATTRIBUTES - set(attributes)):
        raise damaged(path, f"attributes {', '.join(missing)} are missing")
    for key, possible in (("format", READABLE), ("control_hz", (CONTROL_HZ,))):
        if attributes[key] not in possible:
            raise StageError(
                f"{path} has {key} {attributes[key]}; this version reads {' and '.join(map(str, possible))}; "
                "generate the data again"
            )


def check_rows(
    path: Path, group: zarr.Group, attributes: Mapping[str, Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Shapes, types, lengths, and one read from every file.

    Returns the row after the last of each episode (E,) and its seed (E,). Raises StageError that says what is
    damaged.
    """
    arrays = _arrays(path, group, attributes)
    episodes = arrays["meta/episode_ends"].shape[0]
    ends = _whole(path, arrays, "meta/episode_ends", episodes)
    if np.any(np.diff(ends, prepend=0) <= 0):
        raise damaged(path, f"meta/episode_ends does not rise: {ends.tolist()}")
    steps = int(ends[-1]) if len(ends) else 0
    for name, array in arrays.items():
        _check_length(path, name, array, steps if name.startswith("data/") else episodes)
    seeds = _whole(path, arrays, "meta/seed", episodes)
    values, counts = np.unique(seeds, return_counts=True)
    if repeated := values[counts > 1].tolist():
        raise damaged(path, f"meta/seed holds seeds more than once: {repeated}")
    return ends, seeds


def _arrays(path: Path, group: zarr.Group, attributes: Mapping[str, Any]) -> dict[str, zarr.Array[Any]]:
    """All arrays of the layout, of the shapes and types that it says."""
    arrays = {}
    for name, (shape, dtype) in layout(attributes).items():
        with blames(path, f"{name} is missing or cannot be opened"):
            array = arrays[name] = array_of(group, name)
        if array.shape[1:] != shape or array.dtype != np.dtype(dtype):
            found = f"{array.dtype} {('T', *array.shape[1:])}"
            raise damaged(path, f"{name} is {found}, expected {dtype} {('T', *shape)}")
    return arrays


def _whole(path: Path, arrays: Mapping[str, zarr.Array[Any]], name: str, rows: int) -> NDArray[Any]:
    """The first rows of an array, once each of their files is known to answer."""
    _check_length(path, name, arrays[name], rows)
    with blames(path, f"{name} cannot be read"):
        return np.asarray(arrays[name][:rows])


def _check_length(path: Path, name: str, array: zarr.Array[Any], expected: int) -> None:
    if array.shape[0] < expected:
        raise damaged(path, f"{name} has {array.shape[0]} rows, {expected} expected")
    for first in range(0, expected, rows_a_file(array)):
        last = min(first + rows_a_file(array), expected) - 1
        try:
            require_file(path, name, array, first)
            array[last]
        except Exception as error:  # whatever a decoder raises on damaged bytes
            raise damaged(
                path,
                f"{name} has only {first} readable rows, {expected} expected: rows {first} to {last} in file "
                f"{file_of(array, first)} cannot be read ({error})",
            ) from error


def require_file(path: Path, name: str, array: zarr.Array[Any], row: int) -> None:
    """Raises FileNotFoundError where the file with that row is missing: Zarr would take it for zeros."""
    file = Path(name) / file_of(array, row)
    if not (path / file).is_file():
        raise FileNotFoundError(f"file {file} is missing")
