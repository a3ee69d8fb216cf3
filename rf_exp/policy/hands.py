"""Actions as motions of hands: where the TCP is sent, beside the joints that it takes.

A network that predicts seven joints makes small mistakes in each, which add up at the fingers; where the TCP
goes it predicts more sharply. Its joints say which of the arm's many postures is meant:
the nearest with the same last joint.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.observation import POSE, Senses, tcp_poses
from rf_exp.policy.view import ACTION_SIZE, Stream
from rf_exp.robots import Panda
from rf_exp.transforms import from_axes, planar
from rf_exp.types import ARM_JOINTS

TURNS_RAD = np.linspace(-0.3, 0.3, 61)
FARTHEST_RAD = 0.35  # from the predicted joints; what is farther is another posture, and not meant


def with_hands(senses: Senses, stream: Stream, action: NDArray[np.floating]) -> NDArray[np.float32]:
    """Actions (..., n, 8) of the n agents of a stream -> (..., 8n + 9n), with the poses of their TCPs."""
    poses = tcp_poses(senses, stream, action[..., :ARM_JOINTS])
    joined = [action.reshape(*action.shape[:-2], -1), poses.reshape(*poses.shape[:-2], -1)]
    return np.concatenate(joined, axis=-1).astype(np.float32)


def followed(senses: Senses, stream: Stream, chunk: NDArray[np.float64]) -> NDArray[np.float64]:
    """Predicted actions (T, 8n + 9n) -> joints and grippers (T, n, 8) that put the TCPs where they belong."""
    agents: Sequence[int] = stream.agents
    actions = chunk[:, : len(agents) * ACTION_SIZE].reshape(len(chunk), len(agents), ACTION_SIZE).copy()
    poses = chunk[:, len(agents) * ACTION_SIZE :].reshape(len(chunk), len(agents), POSE)
    world_from_base = planar(*senses.bases[agents[0] - 1])  # in whose frame the poses are
    for row, agent in enumerate(agents):
        arm = Panda(planar(*senses.bases[agent - 1]))
        joints, pose = actions[:, row, :ARM_JOINTS], poses[:, row]
        x, y = pose[:, 3:6], pose[:, 6:9]
        axes = zip(pose[:, :3], np.cross(x, y), y, strict=True)
        base_from_tcp = np.stack([from_axes(place, z=out, y=across) for place, out, across in axes])
        turns = joints[:, -1:] + TURNS_RAD  # with its own last joint alone a pose may just be out of reach
        found = arm.postures((world_from_base @ base_from_tcp)[:, None], turns).reshape(
            len(joints), -1, ARM_JOINTS
        )
        away = np.nan_to_num(np.abs(found - joints[:, None]).max(axis=-1), nan=np.inf)
        nearest = away.argmin(axis=1)
        near = away[np.arange(len(away)), nearest] < FARTHEST_RAD
        joints[near] = found[near, nearest[near]]
    return actions
