"""Export as robomimic's HDF5: one group per episode, read by its `SequenceDataset`.

Observations have the names of the store, agents concatenated, and `<camera>_image`; `actions` are the joint
targets in rad and gripper commands of all agents. Next observations are not duplicated: open it with
`load_next_obs=False`. `mask/train` and `mask/valid` name the training and validation episodes.
"""

import json
from pathlib import Path

import numpy as np

from rf_exp.data.formats import Advance, create_datasets, flatten_agents, import_library, success_flags
from rf_exp.store import Store
from rf_exp.types import Episode

PICTURES = ("gzip", "plain")  # both keep every pixel
TAGS = ("robomimic",)
FILE = "demonstrations.hdf5"
VALID_EVERY = 10  # episodes; the share of robomimic's own script


def describe(pictures: str) -> str:
    return (
        f"`{FILE}`, for robomimic's `SequenceDataset` with `load_next_obs=False`: a group `data/demo_<k>`\n"
        "for each episode, with `actions` (joint targets in rad, gripper commands; one agent behind the\n"
        "other), `obs/qpos`, `obs/qvel`, `obs/pose_<object>` and `obs/<camera>_image`, pictures as they\n"
        f"were ({pictures}), `dones` and `rewards`. `mask/train` and `mask/valid` name the episodes for\n"
        "`hdf5_filter_key` and `hdf5_validation_filter_key`: the last of every ten is for validation."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance) -> None:
    with import_library("h5py").File(folder / FILE, "w") as file:
        data = file.create_group("data")
        for index in range(len(store)):
            _write(data.create_group(f"demo_{index}"), store.episode(index), pictures == "gzip")
            advance()
        for name, indices in split(len(store)).items():
            file[f"mask/{name}"] = np.array([f"demo_{index}" for index in indices], "S")
        environment = {"env_name": store.attrs["task"], "type": 2, "env_kwargs": {}}  # 2: of gymnasium
        description = store.description.attributes() if store.description else {}
        data.attrs.update(
            {
                "total": store.steps,
                "env_args": json.dumps(environment),
                "description": json.dumps(description),
            }
        )


def split(episodes: int) -> dict[str, list[int]]:
    """Indices of the training (`train`) and validation (`valid`) episodes, in the order of the store.

    The last of every ten is for validation, or of fewer than ten the last; a single one is for training.
    Episodes keep their part when a store of ten or more grows.
    """
    valid = range(min(VALID_EVERY, episodes) - 1, episodes, VALID_EVERY) if episodes > 1 else ()
    return {"train": [k for k in range(episodes) if k not in valid], "valid": [*valid]}


def _write(group, episode: Episode, compressed: bool) -> None:  # an h5py.Group
    steps = len(episode.qpos)
    values = {
        "actions": flatten_agents(episode.action),
        "rewards": success_flags(steps).astype(np.float32),
        "dones": success_flags(steps).astype(np.int64),
        "obs/qpos": flatten_agents(episode.qpos),
        "obs/qvel": flatten_agents(episode.qvel),
        **{f"obs/pose_{name}": poses for name, poses in episode.poses.items()},
    }
    if episode.executed is not None:
        values["executed"] = flatten_agents(episode.executed)
    create_datasets(group, values)
    create_datasets(
        group, {f"obs/{camera}_image": frames for camera, frames in episode.images.items()}, compressed
    )
    group.attrs["num_samples"] = steps
    group.attrs["seed"] = episode.seed
