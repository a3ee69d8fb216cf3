"""Start offsets: demonstrations augmented with other start postures that join the demonstrated motion.

There are only as many start postures as demonstrations, and an arm has seven joints. The motion to the first
grasp also shows how to get there from postures near it: its joints are shifted by an offset that decreases
with the distance travelled, and vanishes where the approach to the grasp begins. The expert would have
moved like this, in a straight line from the shifted start.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.inputs.observation_spec import ObservationSpec, changes, footprint, widths
from rf_exp.policy.inputs.pictures import calibrations
from rf_exp.policy.inputs.rows import meant, measured
from rf_exp.policy.inputs.view import View
from rf_exp.robots import Robot
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS

if TYPE_CHECKING:
    from rf_exp.store import Store

APPROACH_M = 0.1  # distance of the TCP from the first grasp within which motion is as demonstrated

Floats = NDArray[np.float64]


class Starts:
    """Fraction of a start offset left, for the n agents of each stream of a view, at each of S * T steps."""

    def __init__(
        self, store: "Store", view: View, spec: ObservationSpec, kept: NDArray[np.bool_] | slice
    ) -> None:
        self._robots = [[spec.robot(agent) for agent in stream.agents] for stream in view.streams]
        left, bases = [], []
        for stream, robots in zip(view.streams, self._robots, strict=True):
            own = np.array(stream.agents) - 1
            stands = calibrations(store, stream.cameras)
            episodes = zip(*map(store.by_episode, (measured(store), meant(store))), stands, strict=True)
            of_stream, placed = [], []
            for qpos, action, calibration in episodes:
                apart = widths(qpos)
                parts = [_left(r, action[:, k], apart[:, k]) for r, k in zip(robots, own, strict=True)]
                of_stream.append(np.stack(parts, axis=1))
                world_from_base = np.stack(calibration.world_from_base)[own]
                footprint_from_base = inverse(footprint(world_from_base[0])) @ world_from_base
                placed.append(np.broadcast_to(footprint_from_base, (len(qpos), *world_from_base.shape)))
            left.append(np.concatenate(of_stream)[kept])
            bases.append(np.concatenate(placed)[kept])
        self._steps = len(left[0])  # T
        self.left = np.concatenate(left)  # (S * T, n)
        self._footprint_from_base = np.concatenate(bases)  # (S * T, n, 4, 4)

    def moved(
        self, joints: Floats, steps: NDArray[np.int64], offset: Floats, row: int
    ) -> tuple[Floats, Floats]:
        """Joints (B, K, 7) of the own agent `row` at steps (B, K), shifted by its start offset (B, 7).

        Returns these joints, and the poses of its TCP for them: footprint_from_tcp (B, K, 4, 4).
        """
        found = joints + self.left[steps, row, None] * offset[:, None]
        poses, streams = np.empty((*steps.shape, 4, 4)), steps[:, 0] // self._steps
        for stream in np.unique(streams):
            robot, which = self._robots[stream][row], streams == stream
            found[which, :, robot.dof :] = joints[which, :, robot.dof :]
            poses[which] = robot.tcp_pose(found[which])
        return found, self._footprint_from_base[steps, row] @ poses


def _left(robot: Robot, action: NDArray[np.floating], apart_m: NDArray[np.floating]) -> Floats:
    """Fraction (T,) left, from 1 to 0, by the commands (T, 8) and finger widths (T,) of an arm.

    It is constant while the arm stands still.
    """
    joints = action[:, :ARM_JOINTS]
    changed = changes(action[:, ARM_JOINTS], apart_m)
    grasp = int(changed[0]) if len(changed) else len(joints) - 1
    places = robot.tcp_pose(joints)[:, :3, 3]
    far = np.flatnonzero(np.linalg.norm(places[: grasp + 1] - places[grasp], axis=1) > APPROACH_M)
    gone = np.cumsum(np.linalg.norm(np.diff(joints, axis=0, prepend=joints[:1]), axis=1))
    length = gone[far[-1]] if len(far) else 0.0
    return np.clip(1 - gone / length, 0, 1) if length > 0 else np.zeros(len(joints))
