"""Wire format of policy servers, openpi's `msgpack_numpy`: maps, texts, numbers and arrays as msgpack.

An array is a map of the binary keys `__ndarray__` (true), `data` (its bytes, C order), `dtype` (e.g. `<f4`)
and `shape`; a NumPy number one of `__npgeneric__`, `data` and `dtype`.
"""

from typing import Any

import msgpack
import numpy as np

ARRAY, NUMBER = b"__ndarray__", b"__npgeneric__"
DTYPE_KINDS = "biuf"  # permitted kinds of dtypes: booleans and real numbers
LONGEST_CONTAINER = 2**12  # items of one list or map; arrays are sent as bytes and do not count
MOST_ITEMS = 2**16  # items of all lists and maps of a message: each needs far more memory than its byte there
LARGEST_BYTES = 2**24  # bytes of an answer; no chunk of actions is larger


def pack(value: Any) -> bytes:
    """A value as bytes. Raises TypeError for anything but arrays of numbers and msgpack's own types."""
    packed = msgpack.packb(value, default=_encode)
    assert packed is not None
    return packed


def unpack(data: bytes) -> Any:
    """The value of which `pack` made the bytes; arrays are new. Raises ValueError if invalid or too large."""
    items = 0

    def count_items(container: Any) -> Any:
        nonlocal items
        items += 1 + len(container)
        if items > MOST_ITEMS:
            raise ValueError(f"more than {MOST_ITEMS} items in lists and maps")
        return _decode(container) if isinstance(container, dict) else container

    limits = {"max_array_len": LONGEST_CONTAINER, "max_map_len": LONGEST_CONTAINER}
    try:
        return msgpack.unpackb(data, object_hook=count_items, list_hook=count_items, **limits)
    except (msgpack.UnpackException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{len(data)} bytes that are no message: {type(error).__name__}: {error}") from error


def _encode(value: Any) -> dict[bytes, Any]:
    if not isinstance(value, np.ndarray | np.generic) or value.dtype.kind not in DTYPE_KINDS:
        raise TypeError(f"a {getattr(value, 'dtype', type(value).__name__)} cannot be sent")
    if isinstance(value, np.generic):
        return {NUMBER: True, b"data": value.item(), b"dtype": value.dtype.str}
    return {ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}


def _decode(mapping: dict[Any, Any]) -> Any:
    if ARRAY not in mapping and NUMBER not in mapping:
        return mapping
    dtype = np.dtype(mapping[b"dtype"])
    if dtype.kind not in DTYPE_KINDS:
        raise ValueError(f"an array of {dtype}")
    if NUMBER in mapping:
        return dtype.type(mapping[b"data"])
    return np.frombuffer(mapping[b"data"], dtype).reshape(mapping[b"shape"]).copy()
