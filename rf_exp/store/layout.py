"""Which arrays a store has, and how they lie in files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from rf_exp.artifacts import whole
from rf_exp.store.description import POSE, command_names, dimensions, explained, joint_names

FORMAT = 3  # of how a store lies in files and what it says
IMAGES = ("rgb", "depth", "segmentation")
JUDGED = ("value", "bound", "unit", "holds")  # the arrays of the conditions of success
PICTURE_CHUNK, PICTURE_SHARD = 8, 256  # frames; a shard is one file
STATE_CHUNK, STATE_SHARD = 128, 1024  # rows; what is damaged in a chunk costs no more than the rows of that
CERTIFICATE_CHUNK, CERTIFICATE_SHARD = 1, 32  # episodes
META_CHUNK = 256  # episodes, a file each
ALWAYS_WRITE = {"write_empty_chunks": True}  # so that a missing file always means damage


def layout(attributes: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Array name -> (shape of one row, dtype), the whole layout of a store."""
    agents, size = attributes["agents"], (attributes["height"], attributes["width"])
    joints, commands = ((agents, len(names(attributes))) for names in (joint_names, command_names))
    executed = {"data/executed": (commands, "float32")} if attributes.get("disturbed") else {}
    return {
        "data/qpos": (joints, "float32"),
        "data/qvel": (joints, "float32"),
        "data/action": (commands, "float32"),
        **executed,
        "data/subgoal": ((agents,), "int16"),
        **{f"data/pose_{name}": ((len(POSE),), "float32") for name in attributes["objects"]},
        **_described(attributes, size),
        **{f"data/rgb_{camera}": ((*size, 3), "uint8") for camera in attributes["cameras"]},
        "meta/seed": ((), "int64"),
        "meta/certificate": ((), np.dtypes.StringDType()),
        "meta/episode_ends": ((), "int64"),
    }


def extra_names(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """`depth_<camera>` and `segmentation_<camera>` of what was asked for."""
    names = (name.removeprefix("data/") for name in layout(attributes))
    return tuple(name for name in names if name.startswith(("depth_", "segmentation_")))


def _described(attributes: Mapping[str, Any], size: tuple[int, int]) -> dict[str, tuple[Any, Any]]:
    """What stores with a description hold besides."""
    if "conditions" not in attributes:
        return {}
    conditions, cameras = (len(attributes["conditions"]),), attributes["cameras"]
    depth, segmentation = (cameras if attributes[key] else () for key in ("depth", "labels"))
    return {
        "data/time_s": ((), "float64"),
        **{
            f"data/condition_{name}": (conditions, dtype)
            for name, dtype in zip(JUDGED, ("float32", "float32", "uint8", "bool"), strict=True)
        },
        **{f"data/depth_{camera}": (size, "uint16") for camera in depth},
        **{f"data/segmentation_{camera}": (size, "uint8") for camera in segmentation},
    }


def is_picture(name: str) -> bool:
    return name.startswith(tuple(f"data/{kind}_" for kind in IMAGES))


def chunking(name: str) -> tuple[int, int | None]:
    """(rows of a chunk, which are compressed together and checked by one sum; rows of a file of such chunks).

    None for a file is one that is a chunk itself.
    """
    if is_picture(name):
        return PICTURE_CHUNK, PICTURE_SHARD
    if name == "meta/certificate":
        return CERTIFICATE_CHUNK, CERTIFICATE_SHARD
    return (META_CHUNK, None) if name.startswith("meta/") else (STATE_CHUNK, STATE_SHARD)


def empty_like(path: Path, attributes: Mapping[str, Any]) -> None:
    """A new store without episodes, with all attributes of another, also those that say who made it.

    Raises OSError where nothing can be created there.
    """
    with whole(path) as draft:
        group = zarr.create_group(draft, attributes=dict(attributes))
        for name, (shape, dtype) in layout(attributes).items():
            chunk, shard = chunking(name)
            group.create_array(
                name,
                shape=(0, *shape),
                dtype=dtype,
                chunks=(chunk, *shape),
                shards=(shard, *shape) if shard else None,
                filters=None,
                compressors=ZstdCodec(level=3, checksum=True),
                dimension_names=dimensions(name),
                attributes=explained(name, attributes),
            )


def array_of(group: zarr.Group, name: str) -> zarr.Array[Any]:
    array = group[name]
    assert isinstance(array, zarr.Array)
    return array


def rows_a_file(array: zarr.Array[Any]) -> int:
    return (array.shards or array.chunks)[0]


def file_of(array: zarr.Array[Any], row: int) -> str:
    """The file of an array that holds a row, below the folder of the array."""
    return array.metadata.encode_chunk_key((row // rows_a_file(array), *[0] * (array.ndim - 1)))


def view(array: zarr.Array[Any], rows: int) -> zarr.Array[Any]:
    """The array as if it had that many rows; the stored shape stays."""
    shaped = array.metadata.update_shape((rows, *array.shape[1:]))
    return zarr.Array(zarr.AsyncArray(shaped, array.store_path, ALWAYS_WRITE))  # pyright: ignore


def write(array: zarr.Array[Any], start: int, values: NDArray[Any]) -> None:
    """Put rows behind `start`, and only then let the stored shape include them."""
    end = start + len(values)
    view(array, end)[start:end] = values
    array.resize((end, *array.shape[1:]))
