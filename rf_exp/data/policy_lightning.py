"""Export as Policy-Lightning's HDF5: commands and camera pictures of each arm, over all rows.

    action_<k> (T, 8) f32                  joint targets in rad, gripper from -1 to 1; arms count from 0
    head_cam_<k>, head_cam_global (T, 3, H, W) u8
    episode_ends (E,) i64                  row after the last of each episode

Its reader uses the commands as the measured joints too. Point clouds are not written.
"""

from pathlib import Path

import numpy as np

from rf_exp.data.formats import Advance, import_library
from rf_exp.data.release import agent_commands
from rf_exp.store import Store

PICTURES = ("gzip", "plain")  # both keep every pixel
TAGS = ("Policy-Lightning",)
FILE = "demonstrations.h5"


def describe(pictures: str) -> str:
    return (
        f"`{FILE}`, the file that Policy-Lightning's `dataset_path` names: `action_<k>` (T, 8) of arm k,\n"
        "from 0 on, joint targets in rad and a gripper command as they were meant, and `head_cam_<k>`\n"
        f"(T, 3, H, W), what its own camera saw before ({pictures}, every pixel kept); `head_cam_global`\n"
        "where there are pictures of that. `episode_ends` (E,) is the row after the last of each episode.\n"
        "It holds neither measured joints nor poses, seeds or calibration."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance) -> None:
    compression = {"compression": "gzip", "compression_opts": 4} if pictures == "gzip" else {}
    size, steps = (3, store.attrs["height"], store.attrs["width"]), store.steps
    dataset_names = {camera: _dataset_name(camera) for camera in store.cameras}
    with import_library("h5py").File(folder / FILE, "w") as file:
        for agent in range(store.agents):
            file.create_dataset(
                f"action_{agent}", data=agent_commands(store, agent, store.action), **compression
            )
        for name in dataset_names.values():
            file.create_dataset(name, (steps, *size), np.uint8, chunks=(1, *size), **compression)
        for index, end in enumerate(store.episode_ends.tolist()):
            for camera, frames in store.episode(index).images.items():
                file[dataset_names[camera]][end - len(frames) : end] = np.moveaxis(frames, -1, 1)
            advance()
        file.create_dataset("episode_ends", data=store.episode_ends)


def _dataset_name(camera: str) -> str:
    number = camera.removeprefix("agent")
    return f"head_cam_{int(number) - 1 if number.isdecimal() else camera}"
