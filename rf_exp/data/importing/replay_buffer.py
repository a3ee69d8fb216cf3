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
from rf_exp.data.importing.buffer_source import Frames, ReplayBufferSource
from rf_exp.data.importing.source import (
    MOST_AGENTS,
    MOST_BYTES,
    MOST_CHUNK_BYTES,
    checked_commands,
    finite_float32,
    require,
    require_shape,
    translating_errors,
)
from rf_exp.data.release import COMMAND_SIZE, QPOS_SIZE
from rf_exp.data.robofactory import COMMAND_ARRAYS
from rf_exp.errors import ArgumentError

FORM = "a Zarr 2 replay buffer of Diffusion Policy"
SAFE = ("blosc", "zstd", "zlib", "gzip", "lz4", "bz2", "lzma")  # codecs that run no code
MOST_FILES = 1_000_000  # of an array
BLOSC_HEADER = 16  # bytes; the last four are the length of the file

_AGENT = re.compile(r"(.+-rf)_Agent(\d{1,2})_(\d+)\.zarr")
_CAMERA = re.compile(r"cam|img|image|rgb")  # in the name of an array
_NUMBER = re.compile(r"[<>|=]?[fiub]\d")


def find_arm_buffers(folder: Path) -> list[Path]:
    """The buffers of all arms of the one data set in a folder, in order of the arms; empty without any.

    Raises ArgumentError where there are several data sets.
    """
    buffers: dict[tuple[str, str], list[tuple[int, Path]]] = {}
    for child in sorted(folder.iterdir()):
        if match := _AGENT.fullmatch(child.name):
            buffers.setdefault((match[1], match[3]), []).append((int(match[2]), child))
    if len(buffers) > 1:
        names_text = ", ".join(f"{task}_Agent<k>_{count}.zarr" for task, count in list(buffers)[:8])
        raise ArgumentError(
            f"{folder} holds several data sets: {names_text}; name the folders of one, an arm after the other"
        )
    return [path for paths_by_arm in buffers.values() for _, path in sorted(paths_by_arm)]


def is_buffer(path: Path) -> bool:
    """Whether a folder has the layout of a replay buffer, complete or not."""
    has_group = (path / ".zgroup").is_file() and (path / "data").is_dir()
    return has_group or (path / "data" / "action" / ".zarray").is_file()


def read(paths: Sequence[Path], task: str) -> ReplayBufferSource:
    """Source of the demonstrations in a buffer, or in those of several arms. Raises StageError if invalid."""
    commands_by_arm, ends, states, frames = [], [], [], {}
    notes: list[str] = []
    for number, path in enumerate(paths):
        columns = _described(path, "data/action")["shape"][-1]
        fits = columns % COMMAND_SIZE == 0 and 0 < columns <= COMMAND_SIZE * MOST_AGENTS
        expected = f"{COMMAND_SIZE} for each arm, seven joints and a gripper"
        require(fits, path, f"data/action has {columns} columns; expected {expected}")
        commands_by_arm.append(checked_commands(path, "data/action", _numbers(path, "data/action")))
        ends.append(_read(path, "meta/episode_ends", (), "iu"))
        states.append(_state(path, commands_by_arm[-1], notes))
        names = sorted(child.name for child in (path / "data").iterdir() if child.is_dir())
        for name in (name for name in names if name not in COMMAND_ARRAYS):
            is_used = len(paths) == 1 or name == "head_camera"
            if is_used and _CAMERA.search(name):
                frames[name if len(paths) == 1 else f"{name}_{number}"] = _frames(path, f"data/{name}")
            else:
                notes.append(f"{path.name}/data/{name} was left out")
    for path, episode_ends, arm_commands in zip(paths[1:], ends[1:], commands_by_arm[1:], strict=True):
        same_episodes = np.array_equal(episode_ends, ends[0]) and len(arm_commands) == len(commands_by_arm[0])
        difference = f"its episodes end elsewhere than those of {paths[0].name}"
        require(same_episodes, path, f"{difference}: these are not arms of one data set")
    measured = [state for state in states if state is not None]
    state = np.concatenate(measured, axis=1) if len(measured) == len(states) else None
    return ReplayBufferSource(
        paths[0], FORM, task, np.concatenate(commands_by_arm, axis=1), ends[0], frames, state, notes
    )


def _state(path: Path, commands: NDArray[np.float32], notes: list[str]) -> NDArray[np.float32] | None:
    """Measured joints (T, N, 9) where `state` holds them; None where it holds commands or is missing."""
    if not (path / "data" / "state").is_dir():
        return None
    state = _numbers(path, "data/state")
    same_rows = len(state) == len(commands)
    require(same_rows, path, f"data/state has {len(state)} rows and data/action {len(commands)}")
    if state.shape[1] == commands.shape[1] * QPOS_SIZE:
        return state.reshape(len(state), -1, QPOS_SIZE)
    if state.shape[1] != commands.shape[1] * COMMAND_SIZE or not np.array_equal(
        state, commands.reshape(state.shape)
    ):
        notes.append(
            f"{path.name}/data/state was left out: {state.shape} are neither measured joints nor commands"
        )
    return None


def _frames(path: Path, name: str) -> Frames:
    array = _array(path, name, (None, None, None), "u")
    require(array.dtype == np.uint8, path, f"{name} holds {array.dtype}; expected uint8")
    return Frames(path, name, array.shape, partial(_rows, path, name, array))


def _numbers(path: Path, name: str) -> NDArray[np.float32]:
    return finite_float32(path, name, _read(path, name, (None,), "f"))


def _read(path: Path, name: str, row: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    array = _array(path, name, row, kinds)
    return _rows(path, name, array, 0, array.shape[0])


def _rows(path: Path, name: str, array: zarr.Array[Any], start: int, end: int) -> NDArray[Any]:
    size = (end - start) * prod(array.shape[1:]) * array.dtype.itemsize
    require(size <= MOST_BYTES, path, f"{name} has {size} bytes in one episode")
    with translating_errors(path, name):
        return np.asarray(array[start:end])


def _array(path: Path, name: str, row: tuple[int | None, ...], kinds: str) -> zarr.Array[Any]:
    """Opens an array; all its files must exist. Raises StageError."""
    metadata = _described(path, name)
    shape, chunks = metadata["shape"], metadata["chunks"]
    require_shape(path, name, shape, row)
    kind, size = metadata["dtype"][-2], int(metadata["dtype"][-1])
    require(
        kind in kinds, path, f"{name} holds {metadata['dtype']}; expected one of the kinds {', '.join(kinds)}"
    )
    grid = [-(-length // chunk) for length, chunk in zip(shape, chunks, strict=True)]
    require(prod(chunks) * size <= MOST_CHUNK_BYTES, path, f"{name} is compressed in chunks of {chunks}")
    require(prod(grid) <= MOST_FILES, path, f"{name} declares {prod(grid)} files")
    separator = metadata.get("dimension_separator", ".")
    for index in np.ndindex(*grid):
        file = path / name / separator.join(map(str, index))
        require(file.is_file(), path, f"{name}: the file {file.relative_to(path)} is missing")
        if isinstance(codec := metadata.get("compressor"), dict) and codec.get("id") == "blosc":
            _check_length(path, name, file)
    with translating_errors(path, name):
        array = zarr.open_array(path / name, mode="r", zarr_format=2)
        is_consistent = array.shape == tuple(shape) and array.dtype == np.dtype(metadata["dtype"])
    require(is_consistent, path, f"{name} is described in two ways")
    return array


def _check_length(path: Path, name: str, file: Path) -> None:
    """Raises StageError for a Blosc file that is shorter or longer than its header says.

    The decoder trusts the header and would read memory beyond the data.
    """
    with translating_errors(path, name), file.open("rb") as stream:
        header, size = stream.read(BLOSC_HEADER), file.stat().st_size
    declared_size = int.from_bytes(header[-4:], "little") if len(header) == BLOSC_HEADER else None
    require(
        declared_size == size,
        path,
        f"{name}: the file {file.relative_to(path)} has {size} bytes, and says {declared_size}",
    )


def _described(path: Path, name: str) -> dict[str, Any]:
    """Metadata of an array from `.zarray`. Raises StageError unless it is a plain array of numbers."""
    file = path / name / ".zarray"
    require(file.is_file(), path, f"{name} is missing")
    metadata = read_json(file, f"restore {path} from a copy")
    require(
        isinstance(metadata, dict) and metadata.get("zarr_format") == 2, path, f"{name} is no array of Zarr 2"
    )
    for key in ("shape", "chunks"):
        sizes = metadata.get(key)
        smallest = 1 if key == "chunks" else 0
        is_valid = isinstance(sizes, list) and all(type(size) is int and size >= smallest for size in sizes)
        require(is_valid and bool(sizes), path, f"{key} of {name} is {json.dumps(sizes)}")
    require(
        len(metadata["shape"]) == len(metadata["chunks"]),
        path,
        f"{name} has chunks of another number of axes",
    )
    dtype = metadata.get("dtype")
    is_numeric = isinstance(dtype, str) and _NUMBER.fullmatch(dtype) is not None
    expected = "expected numbers: objects may be pickles, which are never loaded"
    require(is_numeric, path, f"{name} holds {json.dumps(dtype)}; {expected}")
    compressor, filters = metadata.get("compressor"), metadata.get("filters")
    codec = compressor.get("id") if isinstance(compressor, dict) else compressor
    compression = f"{name} is compressed by {json.dumps(codec)} with filters {json.dumps(filters)}"
    is_safe = (codec is None or codec in SAFE) and not filters
    require(is_safe, path, f"{compression}; possible are {', '.join(SAFE)} alone")
    require(
        metadata.get("dimension_separator", ".") in (".", "/"), path, f"{name} has files of unknown names"
    )
    return metadata
