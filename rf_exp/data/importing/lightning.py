"""Import of HDF5 files of Policy-Lightning, with the arrays of `rf_exp.data.policy_lightning`.

Its documentation and present code keep channels first, earlier code kept them last: the shape decides.
"""

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.data.importing import hdf5
from rf_exp.data.importing.flat import Flat, Frames
from rf_exp.data.importing.source import commands, expect
from rf_exp.data.release import COMMAND

FORM = "an HDF5 file of Policy-Lightning"

_ACTION, _CAMERA = re.compile(r"action_(\d{1,2})"), re.compile(r"head_cam(_\w+)?")


def holds(names: list[str]) -> bool:
    """Whether a file with these top-level names has this format."""
    return "episode_ends" in names and any(map(_ACTION.fullmatch, names))


def read(path: Path, file: Any, task: str) -> Flat:
    """Source of the demonstrations in an open file. Raises StageError where it violates the format."""
    names = hdf5.names(path, file)
    numbers = sorted(int(found[1]) for found in map(_ACTION.fullmatch, names) if found)
    expect(numbers == [*range(len(numbers))], path, f"it has commands of arms {numbers}; expected 0, 1, ...")
    told = []
    for number in numbers:
        name = f"action_{number}"
        found = hdf5.needed(path, file, name, (COMMAND,), "f")
        told.append(commands(path, name, hdf5.rows(path, found, 0, found.shape[0])))
    lengths = [len(each) for each in told]
    expect(len({*lengths}) == 1, path, f"arms have {lengths} rows of commands; expected as many for each")
    ends = hdf5.needed(path, file, "episode_ends", (), "iu")
    frames = {}
    for name in filter(_CAMERA.fullmatch, names):
        found = hdf5.needed(path, file, name, (None, None, None), "u")
        expect(found.dtype == np.uint8, path, f"{name} holds {found.dtype}; expected uint8")
        frames[name] = Frames(path, name, found.shape, partial(hdf5.rows, path, found))
    known = {"episode_ends", *(f"action_{number}" for number in numbers), *frames}
    notes = [f"{name} was left out" for name in names if name not in known][:8]
    whole = np.concatenate(told, axis=1)
    return Flat(
        path,
        FORM,
        task,
        whole,
        hdf5.rows(path, ends, 0, ends.shape[0]),
        frames,
        notes=notes,
        close=file.close,
    )
