"""Frames of a store as arrays over all streams of a view: joints, context, commands, pictures, labels.

S streams over T frames become S * T rows, one stream after the other.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.examples.keypoints import keypoints
from rf_exp.policy.inputs.coordination import phases
from rf_exp.policy.inputs.gripper_history import remembered
from rf_exp.policy.inputs.observation_spec import ObservationSpec, context, others, proprioception, widths
from rf_exp.policy.inputs.pictures import pictures_of, side_by_side
from rf_exp.policy.inputs.rays import rays_of, usual_calibration
from rf_exp.policy.inputs.task_space import task_space_actions
from rf_exp.policy.inputs.view import View
from rf_exp.transforms import from_quaternion
from rf_exp.types import ARM_JOINTS

if TYPE_CHECKING:
    from rf_exp.store import Store

Kept = slice | NDArray[np.bool_]  # the steps of a store that are learned


def low_dim(
    store: "Store",
    view: View,
    config: PolicyConfig,
    spec: ObservationSpec,
    kept: Kept,
    numbers: NDArray[np.int64],
    free: NDArray[np.bool_],
) -> tuple[Tensor, Tensor, Tensor]:
    """Proprioception, the context (grippers, subgoals, true poses, as the spec says), and commands."""
    qpos, action = store.qpos[kept], store.action[kept]
    columns = [np.array(stream.agents) - 1 for stream in view.streams]
    commands = [action[:, agents] for agents in columns]
    if config.task_space_actions:
        streams = zip(view.streams, commands, strict=True)
        commands = [task_space_actions(spec, stream, each) for stream, each in streams]
    else:
        commands = [each.reshape(len(action), -1) for each in commands]
    memory = np.zeros((store.steps, store.agents, 0), np.float32)
    if spec.bases:
        told_and_done = store.action[..., ARM_JOINTS], widths(store.qpos)
        episodes = zip(*map(store.by_episode, told_and_done), strict=True)
        memory = np.concatenate([remembered(*each) for each in episodes])
    if spec.subgoals:
        memory = np.concatenate([memory, phases(numbers, free, spec.subgoals)], axis=-1)
    poses = {name: from_quaternion(store.poses[name][kept]) for name in spec.objects}
    known = [context(spec, view, row, qpos, poses, memory[kept]) for row in range(len(view.streams))]
    return _stack([proprioception(qpos[:, agents]) for agents in columns]), _stack(known), _stack(commands)


def pictures(store: "Store", view: View, config: PolicyConfig, kept: Kept) -> Tensor:
    """(S * T, H, W, 3) uint8 of all streams; nothing for who learns without."""
    if not config.encoder.pictures:
        return torch.empty((0, 0, 0, 3), dtype=torch.uint8)
    return _stack(
        [
            side_by_side([pictures_of(store, camera, config)[kept] for camera in stream.cameras])
            for stream in view.streams
        ]
    )


def keypoint_labels(
    store: "Store",
    view: View,
    config: PolicyConfig,
    spec: ObservationSpec,
    kept: Kept,
    numbers: NDArray[np.int64],
) -> tuple[Tensor, ...]:
    """Pixels, points and headings of keypoints, rays of cameras, and what the others are doing."""
    if not config.encoder.keypoints:
        return (torch.empty(len(view.streams) * len(numbers[kept]), 0),) * 5
    found = [keypoints(store, stream, spec, kept) for stream in view.streams]
    watched = [np.array(others(spec, stream), int) - 1 for stream in view.streams]
    return (
        _stack([each.pixels for each in found]),
        _stack([each.points for each in found]),
        _stack([each.headings for each in found]),
        _stack([each.rays for each in found]),
        _stack([numbers[kept][:, columns] for columns in watched]),
    )


def usual_rays(store: "Store", view: View, config: PolicyConfig) -> Tensor:
    """(S, K, 3, 4) of the cameras of all streams where they usually stand; without keypoints (0,)."""
    if not config.encoder.keypoints:
        return torch.empty(0)
    streams = (rays_of(usual_calibration(store, each.cameras), each) for each in view.streams)
    return torch.from_numpy(np.stack([*streams]))


def _stack(arrays: Sequence[NDArray]) -> Tensor:
    """One after the other; what is alone is not copied, which matters for pictures."""
    return torch.from_numpy(np.concatenate(arrays) if len(arrays) > 1 else arrays[0])
