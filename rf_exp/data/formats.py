"""Shared helpers of the exporters, and optional libraries of exporters and importers."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError

Advance = Callable[[], object]  # called after each episode


def import_library(name: str) -> Any:
    """Imports a module that a format needs. Raises ArgumentError that says how to install it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ArgumentError(
            f"this format needs {name.partition('.')[0]}, which is not installed ({error}); "
            'install what formats of others need: pip install -e ".[export]"'
        ) from error


def create_datasets(group: Any, arrays: Mapping[str, NDArray[Any]], compressed: bool = False) -> None:
    """Creates arrays in an HDF5 group, by name; `compressed` compresses each row as a chunk of its own."""
    for name, rows in arrays.items():
        chunked = {"chunks": (1, *rows.shape[1:]), "compression": "gzip"} if compressed else {}
        group.create_dataset(name, data=rows, **chunked)


def flatten_agents(values: NDArray[Any]) -> NDArray[Any]:
    """(T, N, D) -> (T, N * D)."""
    return values.reshape(len(values), -1)


def success_flags(steps: int) -> NDArray[np.bool_]:
    """(T,) true in the last row only: every stored episode succeeds, and ends, with its last action."""
    return np.arange(steps) == steps - 1
