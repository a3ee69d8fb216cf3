"""Checked reading of HDF5 files: groups and arrays that exist as declared, within the file itself."""

import re
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.data.importing.source import MOST_BYTES, MOST_CHUNK_BYTES, checked_shape, expect, reads
from rf_exp.data.target import library

# Cameras and objects with such names can be kept in a store.
NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)


def opened(path: Path) -> Any:
    """An h5py.File for reading. Raises StageError where it cannot be opened, ArgumentError without h5py."""
    h5py = library("h5py")
    with reads(path, "it"):
        return h5py.File(path, "r")


def names(path: Path, group: Any) -> list[str]:
    """Names of the members of a group. Raises StageError."""
    with reads(path, f"the list of what is in {group.name}"):
        return [str(name) for name in group]


def member(path: Path, group: Any, name: str) -> Any:
    """A group or array by its path within a group; None where it is missing.

    Raises StageError for soft and external links: they can lead to any file that the user can read.
    """
    h5py = library("h5py")
    found = group
    for part in name.split("/"):
        with reads(path, f"{group.name}/{name}"):
            if not is_group(found) or part not in found:
                return None
            link = found.get(part, getlink=True)
            expect(isinstance(link, h5py.HardLink), path, f"{group.name}/{name} is a link to elsewhere")
            found = found[part]
    return found


def is_group(found: Any) -> bool:
    return isinstance(found, library("h5py").Group)


def subgroup(path: Path, group: Any, name: str) -> Any:
    """A group within a group; None where it is missing. Raises StageError where it is not a group."""
    found = member(path, group, name)
    expect(found is None or is_group(found), path, f"{group.name}/{name} is no group")
    return found


def array(path: Path, group: Any, name: str, row: tuple[int | None, ...], kinds: str) -> Any:
    """A dataset within a group, with all its bytes in the file; None where it is missing.

    `row` is the shape of its rows (None: any size), `kinds` are the permitted kinds of its dtype. Raises
    StageError.
    """
    found, said = member(path, group, name), f"{group.name}/{name}"
    if found is None:
        return None
    expect(isinstance(found, library("h5py").Dataset), path, f"{said} is no array")
    with reads(path, said):
        shape, dtype, chunks = found.shape, found.dtype, found.chunks
        elsewhere = bool(found.external) or found.is_virtual
    expect(shape is not None, path, f"{said} is empty")
    expect(dtype.kind in kinds, path, f"{said} holds {dtype}; expected one of the kinds {', '.join(kinds)}")
    checked_shape(path, said, shape, row)
    expect(not elsewhere, path, f"{said} lies in another file")
    with reads(path, said):
        if chunks:
            most, there = prod(chunks) * dtype.itemsize, found.id.get_num_chunks()
            needed = prod(-(-n // c) for n, c in zip(shape, chunks, strict=True))
        else:
            most, there, needed = 0, found.id.get_storage_size(), found.nbytes
    expect(most <= MOST_CHUNK_BYTES, path, f"{said} is compressed in chunks of {most} bytes")
    expect(there >= needed, path, f"{said} declares {shape[0]} rows, of which parts are not in the file")
    return found


def needed(path: Path, group: Any, name: str, row: tuple[int | None, ...], kinds: str) -> Any:
    """As `array`, but raises StageError where it is missing."""
    found = array(path, group, name, row, kinds)
    expect(found is not None, path, f"{group.name.rstrip('/')}/{name} is missing")
    return found


def rows(path: Path, found: Any, start: int, end: int) -> NDArray[Any]:
    """Reads rows of a dataset. Raises StageError."""
    size = (end - start) * prod(found.shape[1:]) * found.dtype.itemsize
    expect(size <= MOST_BYTES, path, f"{found.name} has {size} bytes in one episode")
    with reads(path, f"{found.name}, rows {start} to {end - 1},"):
        return np.asarray(found[start:end])
