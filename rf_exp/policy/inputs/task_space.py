"""Task-space actions: target poses of the TCP beside the joint targets.

A network that predicts seven joints makes small errors in each, which add up at the fingers; it predicts the
TCP more precisely. The predicted joints select among the many postures of the arm at that TCP pose: the
nearest with the same last joint.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.inputs.observation_spec import POSE_SIZE, ObservationSpec, footprint, tcp_poses
from rf_exp.policy.inputs.view import ACTION_SIZE, Stream
from rf_exp.robots import Arm
from rf_exp.transforms import Matrix, from_axes
from rf_exp.types import ARM_JOINTS

# Offsets of the last joint that are searched: at the predicted one alone a pose may be slightly out of reach.
# Below an upright shoulder a hundredth of that turns the first and third joint by a radian: hence finer ones.
LAST_JOINT_OFFSETS_RAD = tuple(np.linspace(-reach, reach, 61) for reach in (0.3, 0.015, 0.00075))
CLOSE_RAD = 0.1  # deviation from the predicted joints below which the search ends
FARTHEST_RAD = 0.35  # a larger deviation is another posture, and rejected


def task_space_actions(
    spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, action: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Actions (..., n, 8) of the n agents of a stream -> (..., 8n + 9n), with the poses of their TCPs.

    `bases` (4, 4) are those of all arms.
    """
    poses = tcp_poses(spec, bases, stream, action[..., :ARM_JOINTS])
    parts = [action.reshape(*action.shape[:-2], -1), poses.reshape(*poses.shape[:-2], -1)]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def joint_actions(
    spec: ObservationSpec, bases: Sequence[Matrix], stream: Stream, chunk: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Predicted actions (T, 8n + 9n) -> joints and grippers (T, n, 8) for the predicted TCP poses."""
    agents: Sequence[int] = stream.agents
    actions = chunk[:, : len(agents) * ACTION_SIZE].reshape(len(chunk), len(agents), ACTION_SIZE).copy()
    poses = chunk[:, len(agents) * ACTION_SIZE :].reshape(len(chunk), len(agents), POSE_SIZE)
    world_from_footprint = footprint(bases[agents[0] - 1])
    for row, agent in enumerate(agents):
        arm = Arm(spec.robot(agent), bases[agent - 1])
        joints, pose = actions[:, row, : arm.robot.dof], poses[:, row]
        x, y = pose[:, 3:6], pose[:, 6:9]
        axes = zip(pose[:, :3], np.cross(x, y), y, strict=True)
        footprint_from_tcp = np.stack(
            [from_axes(position, z=z_axis, y=y_axis) for position, z_axis, y_axis in axes]
        )
        actions[:, row, : arm.robot.dof] = nearest_postures(
            arm, world_from_footprint @ footprint_from_tcp, joints
        )
    return actions


def nearest_postures(
    arm: Arm, poses: NDArray[np.float64], joints: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Postures at TCP poses (T, 4, 4) nearest to joints (T, dof); the latter where none is close enough."""
    best, error = joints.copy(), np.full(len(joints), np.inf)
    for offsets in LAST_JOINT_OFFSETS_RAD:
        far = np.flatnonzero(error > CLOSE_RAD)
        if not len(far):
            break
        postures = arm.postures(
            poses[far, None], best[far, -1:] + (offsets if arm.robot.is_redundant else (0.0,))
        )
        postures = postures.reshape(len(far), -1, arm.robot.dof)
        errors = np.nan_to_num(np.abs(postures - joints[far, None]).max(axis=-1), nan=np.inf)
        chosen = np.arange(len(far)), errors.argmin(axis=1)
        improved = errors[chosen] < error[far]
        best[far[improved]], error[far[improved]] = (
            postures[chosen][improved],
            errors[chosen][improved],
        )
    return np.where((error < FARTHEST_RAD)[:, None], best, joints)
