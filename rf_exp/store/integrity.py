"""Integrity checks: whether a path holds a store with intact attributes, layout, ends, seeds and files.

Declarations are not trusted: sizes are compared with bounds, and lengths with the files present, before
anything is read or allocated. Other kinds of data are recognised by their layout, without decoding a value,
so that nothing intact is reported as damaged.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.errors import RfError, StageError, refuse_access
from rf_exp.store.layout import (
    FORMAT,
    Description,
    chunking,
    file_of_row,
    get_array,
    is_picture,
    layout,
    rows_per_file,
)
from rf_exp.texts import printable
from rf_exp.types import CONTROL_HZ

ATTRIBUTES = {"format", "task", "identity", "agents", "cameras", "objects", "height", "width", "control_hz"}
SIZES = {"agents": (1, 99), "height": (0, 8192), "width": (0, 8192)}  # least and most; pictures in px
MOST_SURPLUS = 1_000_000  # rows behind the episodes, left by a killed append: 14 hours of motion
OWN_ATTRIBUTES = ("identity", "control_hz")  # attributes that stores of other kinds lack
OWN_ARRAY = "meta/certificate"  # array that stores of other kinds lack
BUFFER_ARRAYS = {"data/action", "meta/episode_ends"}  # arrays that a replay buffer of Diffusion Policy has
LISTED = 8  # arrays listed in a message
BUFFER_KIND = "laid out as a replay buffer of Diffusion Policy"
HDF5 = b"\x89HDF\r\n\x1a\n"
KINDS_BY_MAGIC = {HDF5: "an HDF5 file", b"PK\x03\x04": "a ZIP archive", b"\x80": "a pickle"}


class Damage(StageError):
    """Error: bytes of a store are not as they were written."""


@contextmanager
def translate_decoder_errors(path: Path, make_error: Callable[[str], StageError]) -> Iterator[None]:
    """Turns any exception of a decoder into the error that `make_error` makes of its reason.

    Lack of access or memory raises another StageError.
    """
    try:
        yield
    except RfError:
        raise
    except Exception as error:
        refuse_access(path, error)
        raise make_error(f"({type(error).__name__}: {error})") from error


def raising_damage(path: Path, what: str, rescuable: bool = True) -> AbstractContextManager[None]:
    """Turns any exception of a decoder on damaged bytes into Damage."""
    return translate_decoder_errors(path, lambda why: damage_error(path, f"{what} {why}", rescuable))


def damage_error(path: Path, what: str, rescuable: bool = True) -> Damage:
    """The error for a damaged store; not `rescuable` where its attributes, and so all episodes, are lost."""
    keep = f"keep what is whole with `python -m rf_exp.rescue {path}`, " if rescuable else ""
    lost = "" if rescuable else ", without which no episode can be told from another"
    return Damage(
        f"{path} is damaged: {what}{lost}; restore it from a copy, {keep}or delete it and generate again"
    )


def open_group(path: Path, mode: Literal["r", "r+"]) -> tuple[zarr.Group, dict[str, Any]]:
    """The group of a store and its checked attributes. Raises Damage, StageError for other kinds of data."""
    with raising_damage(path, "it has no attributes that can be read", rescuable=False):
        refuse_other_kinds(path)
        group = zarr.open_group(path, mode=mode, zarr_format=3)
        attributes: dict[str, Any] = dict(group.attrs)
    _check_attributes(path, attributes)
    return group, attributes


def _check_attributes(path: Path, attributes: Mapping[str, Any]) -> None:
    for key, readable in (("format", FORMAT), ("control_hz", CONTROL_HZ)):
        if attributes.get(key, readable) != readable:
            raise StageError(
                f"{path} has {key} {attributes[key]}, made by {_maker(attributes)}; this version reads "
                f"{readable}: generate the data again, or use that version"
            )
    if missing := sorted(ATTRIBUTES - set(attributes)):
        raise damage_error(path, f"attributes {', '.join(missing)} are missing", rescuable=False)
    for key, (least, most) in SIZES.items():
        if type(value := attributes[key]) is not int or not least <= value <= most:
            raise damage_error(path, f"{key} is {value!r}; expected {least} to {most}", rescuable=False)
    with raising_damage(path, "its attributes do not say which arrays it has", rescuable=False):
        layout(attributes)
        Description.of(attributes)


def _maker(attributes: Mapping[str, Any]) -> str:
    versions, commit = attributes.get("versions"), printable(attributes.get("commit") or "unknown")
    version = versions.get("rf_exp") if isinstance(versions, Mapping) else None
    return f"rf_exp {printable(version or 'of unknown version')}, commit {commit}"


def times_stored(identity: object) -> int:
    """How often a seed may occur in a store: once, unless each episode was rendered several times."""
    copies = identity.get("copies") if isinstance(identity, Mapping) else None
    return copies if type(copies) is int and copies > 0 else 1


def check_rows(
    path: Path, group: zarr.Group, attributes: Mapping[str, Any]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Checks all states and files; returns the row after the last of each episode (E,) and its seed (E,).

    Raises StageError naming the damage.
    """
    arrays = _arrays(path, group, attributes)
    episodes = arrays["meta/episode_ends"].shape[0]
    ends = _read_checked(path, arrays, "meta/episode_ends", episodes)
    if np.any(np.diff(ends, prepend=0) <= 0):
        raise damage_error(path, f"meta/episode_ends does not rise: {ends.tolist()}")
    steps = int(ends[-1]) if len(ends) else 0
    for name, array in arrays.items():
        expected = steps if name.startswith("data/") else episodes
        _check_length(path, name, array, expected)
        if array.shape[0] > expected + MOST_SURPLUS:
            raise damage_error(path, f"{name} declares {array.shape[0]} rows, {expected} expected")
    seeds = _read_checked(path, arrays, "meta/seed", episodes)
    values, counts = np.unique(seeds, return_counts=True)
    times = times_stored(attributes.get("identity"))
    if repeated := values[counts > times].tolist():
        often = "once" if times == 1 else f"{times} times"
        raise damage_error(path, f"meta/seed holds seeds more than {often}: {repeated}")
    return ends, seeds


def _arrays(path: Path, group: zarr.Group, attributes: Mapping[str, Any]) -> dict[str, zarr.Array[Any]]:
    arrays = {}
    for name, (shape, dtype) in layout(attributes).items():
        with raising_damage(path, f"{name} is missing or cannot be opened"):
            array = arrays[name] = get_array(group, name)
        if array.shape[1:] != shape or array.dtype != np.dtype(dtype):
            found = f"{array.dtype} {('T', *array.shape[1:])}"
            raise damage_error(path, f"{name} is {found}, expected {dtype} {('T', *shape)}")
        chunk, shard = chunking(name)
        actual, expected = (
            (array.chunks, array.shards),
            ((chunk, *shape), (shard, *shape) if shard else None),
        )
        if actual != expected:
            raise damage_error(path, f"{name} lies in chunks and files of {actual}, expected {expected}")
    return arrays


def _read_checked(path: Path, arrays: Mapping[str, zarr.Array[Any]], name: str, rows: int) -> NDArray[Any]:
    """The first `rows` rows of an array, after checking that each of their files can be read."""
    _check_length(path, name, arrays[name], rows)
    with raising_damage(path, f"{name} cannot be read"):
        return np.asarray(arrays[name][:rows])


def _check_length(path: Path, name: str, array: zarr.Array[Any], expected: int) -> None:
    if array.shape[0] < expected:
        raise damage_error(path, f"{name} has {array.shape[0]} rows, {expected} expected")
    for first in range(0, expected, rows_per_file(array)):
        last = min(first + rows_per_file(array), expected) - 1
        try:
            require_file(path, name, array, first)
            array[last if is_picture(name) else slice(first, last + 1)]  # pictures are large: one per file
        except Exception as error:  # whatever a decoder raises on damaged bytes
            refuse_access(path, error)
            raise damage_error(
                path,
                f"{name} has only {first} readable rows, {expected} expected: rows {first} to {last} in file "
                f"{file_of_row(array, first)} cannot be read ({error})",
            ) from error


def require_file(path: Path, name: str, array: zarr.Array[Any], row: int) -> None:
    """Raises FileNotFoundError where the file with that row is missing: Zarr would return zeros."""
    file = Path(name) / file_of_row(array, row)
    if not (path / file).is_file():
        raise FileNotFoundError(f"file {file} is missing")


def refuse_other_kinds(path: Path) -> None:
    """Raises StageError for anything but a store of this project, intact or damaged."""
    try:
        if not path.exists():
            raise StageError(
                f"no store at {path}; generate the data first (stages=[generate]), or name the folder of "
                "one, such as outputs/data/.../fast.zarr"
            )
        kind = other_kind(path)
    except OSError as error:
        raise StageError(f"{path} cannot be read: {error.strerror or error}") from error
    if kind:
        raise StageError(
            f"{path} is {kind}; nothing is wrong with it, but it is no store of rf_exp; expected the folder "
            f"of one as stages=[generate] makes it, such as outputs/data/.../fast.zarr{_hint(path, kind)}"
        )


def _hint(path: Path, kind: str) -> str:
    """Hint how to make a store of another kind of data; empty without one."""
    if kind == KINDS_BY_MAGIC[b"\x80"]:
        return ", or make one of the .h5 that the pickle was made of: no pickle is ever loaded"
    if kind == KINDS_BY_MAGIC[HDF5] or (kind.startswith("a Zarr 2 group") and BUFFER_KIND in kind):
        return f", or make one of it with `python -m rf_exp.data import {path} NEW.zarr`"
    return ""


def other_kind(path: Path) -> str:
    """The kind of a file or folder, in words; empty for a store of this project, intact or damaged."""
    if not path.is_dir():
        with path.open("rb") as file:
            start = file.read(8)
        return next((kind for magic, kind in KINDS_BY_MAGIC.items() if start.startswith(magic)), "a file")
    if (path / "zarr.json").is_file():
        metadata = _read_json_object(path / "zarr.json")
        if not metadata or _is_own_store(metadata) or (path / OWN_ARRAY).is_dir():
            return ""  # an unreadable one may be ours
        if _is_own_store(_read_json_object(path.parent / "zarr.json")):
            return f"a part of the store {path.parent}"
        return _describe_zarr(
            3, "array" if metadata.get("node_type") == "array" else "group", path, "zarr.json"
        )
    for name, node in ((".zgroup", "group"), (".zarray", "array"), (".zmetadata", "group")):
        if (path / name).is_file():
            return _describe_zarr(2, node, path, ".zarray")
    if (path / OWN_ARRAY).is_dir():
        return ""  # its zarr.json is lost
    version = _read_json_object(path / "meta/info.json").get("codebase_version")
    if isinstance(version, str):
        return f"a LeRobot data set of version {version}"
    names = sorted(each.name for each in path.iterdir())
    if not names:
        return "an empty folder"
    stores = [name for name in names if name.endswith(".zarr")]
    if stores:
        return f"a folder of {len(stores)} stores ({', '.join(stores[:LISTED])})"
    return f"a folder without zarr.json ({', '.join(names[:LISTED])}{', ...' if len(names) > LISTED else ''})"


def _describe_zarr(version: int, node: str, path: Path, file: str) -> str:
    files = sorted([*path.glob(f"*/{file}"), *path.glob(f"*/*/{file}")]) if node == "group" else []
    shapes = {
        file.parent.relative_to(path).as_posix(): _read_json_object(file).get("shape") for file in files
    }
    shapes_by_name = {name: tuple(shape) for name, shape in shapes.items() if isinstance(shape, list)}
    kind = f", {BUFFER_KIND}" if shapes_by_name.keys() >= BUFFER_ARRAYS else ""
    named = ", ".join(f"{name} {shape}" for name, shape in list(shapes_by_name.items())[:LISTED])
    more = f" and {len(shapes_by_name) - LISTED} more" if len(shapes_by_name) > LISTED else ""
    return f"a Zarr {version} {node}{kind}{f' ({named}{more})' if shapes_by_name else ''}"


def _is_own_store(metadata: dict[str, Any]) -> bool:
    attributes = metadata.get("attributes")
    return isinstance(attributes, dict) and any(name in attributes for name in OWN_ATTRIBUTES)


def _read_json_object(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
