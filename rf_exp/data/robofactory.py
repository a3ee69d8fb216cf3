"""Export as the Zarr 2 of the authors' release, a replay buffer of Diffusion Policy for each arm.

    <Task>-rf_Agent<k>_<N>.zarr/
        data/head_camera (T, 3, H, W) u8             pictures of the arm's own camera before the action
        data/action, state, tcp_action (T, 8) f32    the commands, three times
        meta/episode_ends (E,) i64                   row after the last of each episode

Their policies train with `state` as the measured joints; in rollouts they get the last command instead.
"""

from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import zarr

from rf_exp.data.formats import Advance
from rf_exp.data.release import agent_commands, environment
from rf_exp.errors import ArgumentError
from rf_exp.store import Store

PICTURES = ("blosc",)  # as the release compresses them; every pixel is kept
TAGS = ("RoboFactory", "Diffusion Policy")
ROWS_PER_CHUNK = 100  # rows, as there
COMMAND_ARRAYS = ("action", "state", "tcp_action")


def describe(pictures: str) -> str:
    return (
        "`<Task>-rf_Agent<k>_<N>.zarr`, a Zarr 2 replay buffer for each arm k, from 0 on, of N\n"
        "demonstrations, as the authors' release keeps them in `data/zarr_data`. `action`, `state` and\n"
        "`tcp_action` (T, 8) are all what the arm was meant to do, joint targets in rad and a gripper\n"
        f"command; `head_camera` (T, 3, H, W) is what its own camera saw before ({pictures}, every pixel\n"
        "kept). It holds neither measured joints nor poses, seeds, calibration or the pictures of the\n"
        "global camera."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance) -> None:
    """Writes all episodes of a store, one buffer per arm.

    Raises ArgumentError where an arm has no pictures of its own.
    """
    cameras = [f"agent{agent}" for agent in range(1, store.agents + 1)]
    if missing := [camera for camera in cameras if camera not in store.cameras]:
        raise ArgumentError(
            f"{store.path} has no pictures of {', '.join(missing)}, but the release's Zarr holds those "
            f"of each arm; there are {', '.join(store.cameras) or 'none'}: generate with cameras=local"
        )
    size = 3, store.attrs["height"], store.attrs["width"]
    arrays = []
    for agent in range(store.agents):
        path = folder / f"{environment(store.attrs['task'])}_Agent{agent}_{len(store)}.zarr"
        group = zarr.open_group(path, mode="w", zarr_format=2)
        actions = agent_commands(store, agent, store.action)
        for name in COMMAND_ARRAYS:
            _create(group, f"data/{name}", actions.shape, "<f4")[:] = actions
        _create(group, "meta/episode_ends", (len(store),), "<i8")[:] = store.episode_ends
        arrays.append(_create(group, "data/head_camera", (store.steps, *size), "|u1"))
    for index, end in enumerate(store.episode_ends.tolist()):
        images = store.episode(index).images
        for camera, array in zip(cameras, arrays, strict=True):
            frames = images[camera]
            array[end - len(frames) : end] = np.moveaxis(frames, -1, 1)
        advance()


def _create(group: zarr.Group, name: str, shape: tuple[int, ...], dtype: str) -> zarr.Array[Any]:
    return group.create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=(ROWS_PER_CHUNK, *shape[1:]),
        compressors=numcodecs.Blosc("zstd", clevel=3, shuffle=1),
        config={"write_empty_chunks": True},  # importers take a missing file for damage
    )
