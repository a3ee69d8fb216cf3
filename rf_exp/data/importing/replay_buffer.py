"""Import of Zarr 2 replay buffers of Diffusion Policy and the authors' release (`rf_exp.data.robofactory`).

Some buffers hold one arm, (T, 8), and belong with those of the other arms; some hold all arms, (T, 8N), with
`head_camera_<k>` and `head_camera_global`, or measured joints as `state` (T, 9N). Their compression has no
checksums: a byte changed on disk may decode to other values.
"""

import json
import re
from collections.abc import Sequence
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.artifacts import read_json
from rf_exp.data.importing.flat import Flat, Frames
from rf_exp.data.importing.source import (
    MOST_AGENTS,
    MOST_BYTES,
    MOST_CHUNK_BYTES,
    checked_shape,
    commands,
    expect,
    numbers,
    reads,
)
from rf_exp.data.release import COMMAND, MEASURED
from rf_exp.data.robofactory import TOLD
from rf_exp.errors import ArgumentError

FORM = "a Zarr 2 replay buffer of Diffusion Policy"
SAFE = ("blosc", "zstd", "zlib", "gzip", "lz4", "bz2", "lzma")  # codecs that run no code
MOST_FILES = 1_000_000  # of an array
BLOSC_HEADER = 16  # bytes; the last four are the length of the file

_AGENT = re.compile(r"(.+-rf)_Agent(\d{1,2})_(\d+)\.zarr")
_CAMERA = re.compile(r"cam|img|image|rgb")  # in the name of an array
_NUMBER = re.compile(r"[<>|=]?[fiub]\d")


def arms(folder: Path) -> list[Path]:
    """The buffers of all arms of the one data set in a folder, in order of the arms; empty without any.

    Raises ArgumentError where there are several data sets.
    """
    found: dict[tuple[str, str], list[tuple[int, Path]]] = {}
    for each in sorted(folder.iterdir()):
        if said := _AGENT.fullmatch(each.name):
            found.setdefault((said[1], said[3]), []).append((int(said[2]), each))
    if len(found) > 1:
        listed = ", ".join(f"{task}_Agent<k>_{count}.zarr" for task, count in list(found)[:8])
        raise ArgumentError(
            f"{folder} holds several data sets: {listed}; name the folders of one, an arm after the other"
        )
    return [path for each in found.values() for _, path in sorted(each)]


def is_buffer(path: Path) -> bool:
    """Whether a folder has the layout of a replay buffer, complete or not."""
    whole = (path / ".zgroup").is_file() and (path / "data").is_dir()
    return whole or (path / "data" / "action" / ".zarray").is_file()


def read(paths: Sequence[Path], task: str) -> Flat:
    """Source of the demonstrations in a buffer, or in those of several arms. Raises StageError if invalid."""
    told, ends, states, frames = [], [], [], {}
    notes: list[str] = []
    for number, path in enumerate(paths):
        columns = _described(path, "data/action")["shape"][-1]
        fits = columns % COMMAND == 0 and 0 < columns <= COMMAND * MOST_AGENTS
        possible = f"{COMMAND} for each arm, seven joints and a gripper"
        expect(fits, path, f"data/action has {columns} columns; expected {possible}")
        told.append(commands(path, "data/action", _numbers(path, "data/action")))
        ends.append(_read(path, "meta/episode_ends", (), "iu"))
        states.append(_state(path, told[-1], notes))
        names = sorted(each.name for each in (path / "data").iterdir() if each.is_dir())
        for name in (name for name in names if name not in TOLD):
            own = len(paths) == 1 or name == "head_camera"
            if own and _CAMERA.search(name):
                frames[name if len(paths) == 1 else f"{name}_{number}"] = _frames(path, f"data/{name}")
            else:
                notes.append(f"{path.name}/data/{name} was left out")
    for path, one, other in zip(paths[1:], ends[1:], told[1:], strict=True):
        same = np.array_equal(one, ends[0]) and len(other) == len(told[0])
        elsewhere = f"its episodes end elsewhere than those of {paths[0].name}"
        expect(same, path, f"{elsewhere}: these are not arms of one data set")
    measured = [state for state in states if state is not None]
    state = np.concatenate(measured, axis=1) if len(measured) == len(states) else None
    return Flat(paths[0], FORM, task, np.concatenate(told, axis=1), ends[0], frames, state, notes)


def _state(path: Path, told: NDArray[np.float32], notes: list[str]) -> NDArray[np.float32] | None:
    """Measured joints (T, N, 9) where `state` holds them; None where it holds commands or is missing."""
    if not (path / "data" / "state").is_dir():
        return None
    found = _numbers(path, "data/state")
    same_rows = len(found) == len(told)
    expect(same_rows, path, f"data/state has {len(found)} rows and data/action {len(told)}")
    if found.shape[1] == told.shape[1] * MEASURED:
        return found.reshape(len(found), -1, MEASURED)
    if found.shape[1] != told.shape[1] * COMMAND or not np.array_equal(found, told.reshape(found.shape)):
        notes.append(
            f"{path.name}/data/state was left out: {found.shape} are neither measured joints nor commands"
        )
    return None


def _frames(path: Path, name: str) -> Frames:
    array = _array(path, name, (None, None, None), "u")
    expect(array.dtype == np.uint8, path, f"{name} holds {array.dtype}; expected uint8")
    return Frames(path, name, array.shape, partial(_rows, path, name, array))


def _numbers(path: Path, name: str) -> NDArray[np.float32]:
    return numbers(path, name, _read(path, name, (None,), "f"))


def _read(path: Path, name: str, row: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    array = _array(path, name, row, kinds)
    return _rows(path, name, array, 0, array.shape[0])


def _rows(path: Path, name: str, array: zarr.Array[Any], start: int, end: int) -> NDArray[Any]:
    size = (end - start) * prod(array.shape[1:]) * array.dtype.itemsize
    expect(size <= MOST_BYTES, path, f"{name} has {size} bytes in one episode")
    with reads(path, name):
        return np.asarray(array[start:end])


def _array(path: Path, name: str, row: tuple[int | None, ...], kinds: str) -> zarr.Array[Any]:
    """Opens an array; all its files must exist. Raises StageError."""
    said = _described(path, name)
    shape, chunks = said["shape"], said["chunks"]
    checked_shape(path, name, shape, row)
    kind, size = said["dtype"][-2], int(said["dtype"][-1])
    expect(kind in kinds, path, f"{name} holds {said['dtype']}; expected one of the kinds {', '.join(kinds)}")
    grid = [-(-length // chunk) for length, chunk in zip(shape, chunks, strict=True)]
    expect(prod(chunks) * size <= MOST_CHUNK_BYTES, path, f"{name} is compressed in chunks of {chunks}")
    expect(prod(grid) <= MOST_FILES, path, f"{name} declares {prod(grid)} files")
    separator = said.get("dimension_separator", ".")
    for place in np.ndindex(*grid):
        file = path / name / separator.join(map(str, place))
        expect(file.is_file(), path, f"{name}: the file {file.relative_to(path)} is missing")
        if isinstance(codec := said.get("compressor"), dict) and codec.get("id") == "blosc":
            _check_length(path, name, file)
    with reads(path, name):
        found = zarr.open_array(path / name, mode="r", zarr_format=2)
        same = found.shape == tuple(shape) and found.dtype == np.dtype(said["dtype"])
    expect(same, path, f"{name} is described in two ways")
    return found


def _check_length(path: Path, name: str, file: Path) -> None:
    """Raises StageError for a Blosc file that is shorter or longer than its header says.

    The decoder trusts the header and would read memory beyond the data.
    """
    with reads(path, name), file.open("rb") as opened:
        header, size = opened.read(BLOSC_HEADER), file.stat().st_size
    said = int.from_bytes(header[-4:], "little") if len(header) == BLOSC_HEADER else None
    expect(said == size, path, f"{name}: the file {file.relative_to(path)} has {size} bytes, and says {said}")


def _described(path: Path, name: str) -> dict[str, Any]:
    """Metadata of an array from `.zarray`. Raises StageError unless it is a plain array of numbers."""
    file = path / name / ".zarray"
    expect(file.is_file(), path, f"{name} is missing")
    said = read_json(file, f"restore {path} from a copy")
    expect(isinstance(said, dict) and said.get("zarr_format") == 2, path, f"{name} is no array of Zarr 2")
    for key in ("shape", "chunks"):
        sizes = said.get(key)
        least = 1 if key == "chunks" else 0
        fits = isinstance(sizes, list) and all(type(each) is int and each >= least for each in sizes)
        expect(fits and bool(sizes), path, f"{key} of {name} is {json.dumps(sizes)}")
    expect(len(said["shape"]) == len(said["chunks"]), path, f"{name} has chunks of another number of axes")
    dtype = said.get("dtype")
    plain = isinstance(dtype, str) and _NUMBER.fullmatch(dtype) is not None
    wanted = "expected numbers: objects may be pickles, which are never loaded"
    expect(plain, path, f"{name} holds {json.dumps(dtype)}; {wanted}")
    codec, filters = said.get("compressor"), said.get("filters")
    used = codec.get("id") if isinstance(codec, dict) else codec
    how = f"{name} is compressed by {json.dumps(used)} with filters {json.dumps(filters)}"
    safe = (used is None or used in SAFE) and not filters
    expect(safe, path, f"{how}; possible are {', '.join(SAFE)} alone")
    expect(said.get("dimension_separator", ".") in (".", "/"), path, f"{name} has files of unknown names")
    return said
