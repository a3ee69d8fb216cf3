"""Actions as motions of hands: where the TCP is sent, beside the joints that it takes.

A network that predicts seven joints makes small mistakes in each, which add up at the fingers; where the TCP
goes it predicts more sharply. Its joints say which of the arm's many postures is meant, and Newton steps from
there reach the predicted pose.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.observation import POSE, Senses, tcp_poses
from rf_exp.policy.views import ACTION_SIZE, Stream
from rf_exp.robots import Panda
from rf_exp.transforms import from_axes, planar
from rf_exp.types import ARM_JOINTS

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
        for action, pose in zip(actions[:, row], poses[:, row], strict=True):
            x, y = pose[3:6], pose[6:9]
            base_from_tcp = from_axes(pose[:3], z=np.cross(x, y), y=y)
            found = arm.solve(world_from_base @ base_from_tcp, action[:ARM_JOINTS])
            if found is not None and np.abs(found - action[:ARM_JOINTS]).max() < FARTHEST_RAD:
                action[:ARM_JOINTS] = found
    return actions
