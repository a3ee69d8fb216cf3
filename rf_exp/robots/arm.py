"""A robot that is bolted to the table: kinematics in the world."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.robots.robot import Robot
from rf_exp.transforms import Matrix, inverse

_AWAY_RAD = np.linspace(-5.6, 5.6, 57)  # of the last joint
NEIGHBOUR_RAD = 0.35  # postures nearer than this in every joint are on one branch


class Arm:
    """One robot at `world_from_base` (4, 4)."""

    def __init__(self, robot: Robot, world_from_base: Matrix) -> None:
        self.robot, self.world_from_base = robot, world_from_base
        self._base_from_world = inverse(world_from_base)
        self._solver, self._limits_rad = robot.solver, robot.planned_rad

    def joints(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., dof) of this arm, of measured joints or commands (..., D) of a task with more."""
        return rows[..., : self.robot.dof]

    def tcp(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """world_from_tcp (..., 4, 4) for rows that begin with the joints of the arm, rad."""
        return self.world_from_base @ self.robot.tcp_pose(qpos)

    def links(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """World poses of the robot's links (..., L, 4, 4) for measured joints (..., D)."""
        return self.world_from_base @ self.robot.link_poses(qpos)

    def postures(self, world_from_tcp: NDArray[np.float64], last_rad: ArrayLike) -> NDArray[np.float64]:
        """All joints (..., branches, dof) rad for TCP poses (..., 4, 4) and the last joint (...).

        Within the joint limits and a small margin; NaN where there is no such posture.
        """
        return self._solver.postures(self._base_from_world @ world_from_tcp, last_rad, self._limits_rad)

    def facing(self, world_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles (...) rad of the last joint that put the arm into an upright plane at TCP poses (..., 4, 4).

        Where none is so, the one with which it would be if the tool pointed straight down.
        """
        return self._solver.facing(self._base_from_world @ world_from_tcp)

    def aside_rad(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) rad by which the elbow is out of the upright plane at joints (..., dof)."""
        swivel = self.robot.swivel
        return np.zeros(joints.shape[:-1]) if swivel is None else np.abs(joints[..., swivel])

    def beyond(self, branch: int) -> int:
        """The branch in which an arm goes on beyond a singularity, an upright shoulder for one."""
        return int(self._solver.other[branch])

    def crossed(self, found: NDArray[np.float64]) -> NDArray[np.float64]:
        """Postures (..., branches, dof), each in place of the one of `beyond`, laid out as `postures` are."""
        return np.moveaxis(np.moveaxis(found, -1, 0).take(self._solver.other, axis=-1), 0, -1)

    def solve(self, world_from_tcp: Matrix, near_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joints (dof,) rad that put the TCP at a pose, near to `near_rad`; None where there are none.

        The last joint of an arm with one to spare stays as it is where a neighbouring posture allows that, so
        along a path of near poses the joints go smoothly; otherwise it is the nearest posture of a range.
        """
        near_rad = self.joints(near_rad)
        last = near_rad[-1]
        ranges = (
            [([last], NEIGHBOUR_RAD), (last + _AWAY_RAD, np.inf)] if self.robot.spare else [([last], np.inf)]
        )
        for turns, farthest in ranges:
            found = self.postures(world_from_tcp, turns).reshape(-1, self.robot.dof)
            away = np.abs(found - near_rad).max(axis=1)
            nearest = int(np.nan_to_num(away, nan=np.inf).argmin())
            if away[nearest] < farthest:
                return found[nearest]
        return None
