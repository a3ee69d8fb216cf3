"""Checked reading of HDF5 files: groups and arrays that exist as declared, within the file itself."""

import re
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.data.formats import import_library
from rf_exp.data.importing.source import (
    MOST_BYTES,
    MOST_CHUNK_BYTES,
    require,
    require_shape,
    translating_errors,
)

# Cameras and objects with such names can be kept in a store.
NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)


def open_file(path: Path) -> Any:
    """An h5py.File for reading. Raises StageError where it cannot be opened, ArgumentError without h5py."""
    h5py = import_library("h5py")
    with translating_errors(path, "it"):
        return h5py.File(path, "r")


def member_names(path: Path, group: Any) -> list[str]:
    """Names of the members of a group. Raises StageError."""
    with translating_errors(path, f"the list of what is in {group.name}"):
        return [str(name) for name in group]


def member(path: Path, group: Any, name: str) -> Any:
    """A group or array by its path within a group; None where it is missing.

    Raises StageError for soft and external links: they can lead to any file that the user can read.
    """
    h5py = import_library("h5py")
    node = group
    for part in name.split("/"):
        with translating_errors(path, f"{group.name}/{name}"):
            if not is_group(node) or part not in node:
                return None
            link = node.get(part, getlink=True)
            require(isinstance(link, h5py.HardLink), path, f"{group.name}/{name} is a link to elsewhere")
            node = node[part]
    return node


def is_group(node: Any) -> bool:
    return isinstance(node, import_library("h5py").Group)


def subgroup(path: Path, group: Any, name: str) -> Any:
    """A group within a group; None where it is missing. Raises StageError where it is not a group."""
    subgroup_node = member(path, group, name)
    require(subgroup_node is None or is_group(subgroup_node), path, f"{group.name}/{name} is no group")
    return subgroup_node


def optional_array(path: Path, group: Any, name: str, row: tuple[int | None, ...], kinds: str) -> Any:
    """A dataset within a group, with all its bytes in the file; None where it is missing.

    `row` is the shape of its rows (None: any size), `kinds` are the permitted kinds of its dtype. Raises
    StageError.
    """
    dataset, array_path = member(path, group, name), f"{group.name}/{name}"
    if dataset is None:
        return None
    require(isinstance(dataset, import_library("h5py").Dataset), path, f"{array_path} is no array")
    with translating_errors(path, array_path):
        shape, dtype, chunks = dataset.shape, dataset.dtype, dataset.chunks
        is_external = bool(dataset.external) or dataset.is_virtual
    require(shape is not None, path, f"{array_path} is empty")
    require(
        dtype.kind in kinds, path, f"{array_path} holds {dtype}; expected one of the kinds {', '.join(kinds)}"
    )
    require_shape(path, array_path, shape, row)
    require(not is_external, path, f"{array_path} lies in another file")
    with translating_errors(path, array_path):
        if chunks:
            chunk_bytes, stored_size = prod(chunks) * dtype.itemsize, dataset.id.get_num_chunks()
            required_size = prod(-(-n // c) for n, c in zip(shape, chunks, strict=True))
        else:
            chunk_bytes, stored_size, required_size = 0, dataset.id.get_storage_size(), dataset.nbytes
    require(
        chunk_bytes <= MOST_CHUNK_BYTES, path, f"{array_path} is compressed in chunks of {chunk_bytes} bytes"
    )
    require(
        stored_size >= required_size,
        path,
        f"{array_path} declares {shape[0]} rows, of which parts are not in the file",
    )
    return dataset


def required_array(path: Path, group: Any, name: str, row: tuple[int | None, ...], kinds: str) -> Any:
    """As `optional_array`, but raises StageError where it is missing."""
    dataset = optional_array(path, group, name, row, kinds)
    require(dataset is not None, path, f"{group.name.rstrip('/')}/{name} is missing")
    return dataset


def read_rows(path: Path, dataset: Any, start: int, end: int) -> NDArray[Any]:
    """Reads rows of a dataset. Raises StageError."""
    size = (end - start) * prod(dataset.shape[1:]) * dataset.dtype.itemsize
    require(size <= MOST_BYTES, path, f"{dataset.name} has {size} bytes in one episode")
    with translating_errors(path, f"{dataset.name}, rows {start} to {end - 1},"):
        return np.asarray(dataset[start:end])
