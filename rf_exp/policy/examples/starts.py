"""Start offsets: demonstrations augmented with other start postures that join the demonstrated motion.

There are only as many start postures as demonstrations, and an arm has seven joints. The motion to the first
grasp also shows how to get there from postures near it: its joints are shifted by an offset that decreases
with the distance travelled, and vanishes where the approach to the grasp begins. The expert would have
moved like this, in a straight line from the shifted start.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.inputs.observation_spec import ObservationSpec, finger_openings, footprint, gripper_changes
from rf_exp.policy.inputs.pictures import calibrations
from rf_exp.policy.inputs.rows import intended_commands, measured_joints
from rf_exp.policy.inputs.view import View
from rf_exp.robots import Robot
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS

if TYPE_CHECKING:
    from rf_exp.store import Store

APPROACH_M = 0.1  # distance of the TCP from the first grasp within which motion is as demonstrated

Floats = NDArray[np.float64]


class StartOffsets:
    """Fraction of a start offset left, for the n agents of each stream of a view, at each of S * T steps."""

    def __init__(
        self, store: "Store", view: View, spec: ObservationSpec, selection: NDArray[np.bool_] | slice
    ) -> None:
        self._robots = [[spec.robot(agent) for agent in stream.agents] for stream in view.streams]
        remaining, bases = [], []
        for stream, robots in zip(view.streams, self._robots, strict=True):
            own = np.array(stream.agents) - 1
            episode_calibrations = calibrations(store, stream.cameras)
            episodes = zip(
                *map(store.by_episode, (measured_joints(store), intended_commands(store))),
                episode_calibrations,
                strict=True,
            )
            stream_remaining, stream_bases = [], []
            for qpos, action, calibration in episodes:
                openings = finger_openings(qpos)
                fractions = [
                    _remaining_fraction(robot, action[:, k], openings[:, k])
                    for robot, k in zip(robots, own, strict=True)
                ]
                stream_remaining.append(np.stack(fractions, axis=1))
                world_from_base = np.stack(calibration.world_from_base)[own]
                footprint_from_base = inverse(footprint(world_from_base[0])) @ world_from_base
                stream_bases.append(np.broadcast_to(footprint_from_base, (len(qpos), *world_from_base.shape)))
            remaining.append(np.concatenate(stream_remaining)[selection])
            bases.append(np.concatenate(stream_bases)[selection])
        self._steps = len(remaining[0])  # T
        self.remaining = np.concatenate(remaining)  # (S * T, n)
        self._footprint_from_base = np.concatenate(bases)  # (S * T, n, 4, 4)

    def shifted(
        self, joints: Floats, steps: NDArray[np.int64], offset: Floats, row: int
    ) -> tuple[Floats, Floats]:
        """Joints (B, K, 7) of the own agent `row` at steps (B, K), shifted by its start offset (B, 7).

        Returns these joints, and the poses of its TCP for them: footprint_from_tcp (B, K, 4, 4).
        """
        shifted = joints + self.remaining[steps, row, None] * offset[:, None]
        poses, streams = np.empty((*steps.shape, 4, 4)), steps[:, 0] // self._steps
        for stream in np.unique(streams):
            robot, rows = self._robots[stream][row], streams == stream
            shifted[rows, :, robot.dof :] = joints[rows, :, robot.dof :]
            poses[rows] = robot.tcp_pose(shifted[rows])
        return shifted, self._footprint_from_base[steps, row] @ poses


def _remaining_fraction(
    robot: Robot, action: NDArray[np.floating], openings_m: NDArray[np.floating]
) -> Floats:
    """Fraction (T,) left, from 1 to 0, by the commands (T, 8) and finger widths (T,) of an arm.

    It is constant while the arm stands still.
    """
    joints = action[:, :ARM_JOINTS]
    change_steps = gripper_changes(action[:, ARM_JOINTS], openings_m)
    grasp = int(change_steps[0]) if len(change_steps) else len(joints) - 1
    positions_m = robot.tcp_pose(joints)[:, :3, 3]
    far = np.flatnonzero(np.linalg.norm(positions_m[: grasp + 1] - positions_m[grasp], axis=1) > APPROACH_M)
    travelled = np.cumsum(np.linalg.norm(np.diff(joints, axis=0, prepend=joints[:1]), axis=1))
    length = travelled[far[-1]] if len(far) else 0.0
    return np.clip(1 - travelled / length, 0, 1) if length > 0 else np.zeros(len(joints))
