"""Import of HDF5 files of Policy-Lightning, with the arrays of `rf_exp.data.policy_lightning`.

Its documentation and present code keep channels first, earlier code kept them last: the shape decides.
"""

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.data.importing import hdf5
from rf_exp.data.importing.buffer_source import Frames, ReplayBufferSource
from rf_exp.data.importing.source import checked_commands, require
from rf_exp.data.release import COMMAND_SIZE

FORM = "an HDF5 file of Policy-Lightning"

_ACTION, _CAMERA = re.compile(r"action_(\d{1,2})"), re.compile(r"head_cam(_\w+)?")


def is_lightning_file(names: list[str]) -> bool:
    """Whether a file with these top-level names has this format."""
    return "episode_ends" in names and any(map(_ACTION.fullmatch, names))


def read(path: Path, file: Any, task: str) -> ReplayBufferSource:
    """Source of the demonstrations in an open file. Raises StageError where it violates the format."""
    names = hdf5.member_names(path, file)
    arm_numbers = sorted(int(match[1]) for match in map(_ACTION.fullmatch, names) if match)
    require(
        arm_numbers == [*range(len(arm_numbers))],
        path,
        f"it has commands of arms {arm_numbers}; expected 0, 1, ...",
    )
    commands_by_arm = []
    for number in arm_numbers:
        name = f"action_{number}"
        dataset = hdf5.required_array(path, file, name, (COMMAND_SIZE,), "f")
        commands_by_arm.append(
            checked_commands(path, name, hdf5.read_rows(path, dataset, 0, dataset.shape[0]))
        )
    lengths = [len(arm_commands) for arm_commands in commands_by_arm]
    require(len({*lengths}) == 1, path, f"arms have {lengths} rows of commands; expected as many for each")
    ends = hdf5.required_array(path, file, "episode_ends", (), "iu")
    frames = {}
    for name in filter(_CAMERA.fullmatch, names):
        dataset = hdf5.required_array(path, file, name, (None, None, None), "u")
        require(dataset.dtype == np.uint8, path, f"{name} holds {dataset.dtype}; expected uint8")
        frames[name] = Frames(path, name, dataset.shape, partial(hdf5.read_rows, path, dataset))
    used_names = {"episode_ends", *(f"action_{number}" for number in arm_numbers), *frames}
    notes = [f"{name} was left out" for name in names if name not in used_names][:8]
    all_commands = np.concatenate(commands_by_arm, axis=1)
    return ReplayBufferSource(
        path,
        FORM,
        task,
        all_commands,
        hdf5.read_rows(path, ends, 0, ends.shape[0]),
        frames,
        notes=notes,
        close=file.close,
    )
