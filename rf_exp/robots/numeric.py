"""Inverse kinematics of any arm of six or seven revolute joints, by damped Newton steps from a few postures.

Slower than a closed form, and not complete: a posture that none of the starts leads to is not found. Starts
are the posture of rest and postures drawn once within the limits, all turned towards the pose. Of an arm with
a joint to spare the last joint is given.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

Floats = NDArray[np.float64]

STARTS = 8
STEPS = 60
LONGEST_RAD = 0.5  # of a step, each joint
DAMPING = 1e-3
CLOSE = 1e-8  # m and rad: a posture is found
SAME_RAD = 1e-4  # between postures that are one


class Numeric:
    """Of one robot. Branch k is what start k leads to, unless an earlier one has led there."""

    def __init__(self, robot: "Robot") -> None:
        from rf_exp.robots.chain import chain_of

        self.branches, self.other = STARTS, np.arange(STARTS)
        self._chain, self._free = chain_of(robot), 6  # joints that are solved for
        low, high = self._chain.limits_rad
        rest = np.array(robot.rest_rad)
        near = np.clip(rest + np.random.default_rng(0).uniform(-1.5, 1.5, (STARTS, robot.dof)), low, high)
        self._starts = np.concatenate([rest[None], near[1:]])
        x, y = self._chain.tcp_pose(rest)[:2, 3]
        self._ahead_rad = float(np.arctan2(y, x)) - rest[0]  # of the TCP at rest, from the first joint

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        """See `Inverse`."""
        pose, last = np.asarray(base_from_tcp, dtype=float), np.asarray(last_rad, dtype=float)
        spare = self._chain.dof > self._free
        shape = np.broadcast_shapes(pose.shape[:-2], last.shape)
        goals = np.broadcast_to(pose, (*shape, 4, 4)) if spare else pose
        starts = np.broadcast_to(self._turned(goals), (*goals.shape[:-2], *self._starts.shape)).copy()
        if spare:
            starts[..., -1] = np.broadcast_to(last, shape)[..., None]
        flat = starts.reshape(-1, self._chain.dof)
        wanted = np.broadcast_to(goals[..., None, :, :], (*starts.shape[:-1], 4, 4)).reshape(-1, 4, 4)
        found = self._solved(flat, wanted, limits_rad).reshape(starts.shape)
        found[self._known(found)] = np.nan
        return np.broadcast_to(found, (*shape, *found.shape[-2:])).copy()

    def facing(self, base_from_tcp: Floats) -> Floats:
        """See `Inverse`: that of the nearest posture to rest, of an arm turned towards the pose."""
        pose = np.asarray(base_from_tcp, dtype=float)
        start = self._turned(pose)[..., 0, :]
        if self._chain.dof == self._free:
            return start[..., -1]
        flat, goals = start.reshape(-1, start.shape[-1]).copy(), pose.reshape(-1, 4, 4)
        for _ in range(STEPS):
            flat += self._step(flat, goals, self._chain.dof)
        low, high = self._chain.limits_rad[:, -1]
        return np.clip(flat[:, -1], low, high).reshape(start.shape[:-1])

    def _turned(self, pose: Floats) -> Floats:
        """(..., STARTS, dof) starts with the first joint towards poses (..., 4, 4)."""
        towards = np.arctan2(pose[..., 1, 3], pose[..., 0, 3]) - self._ahead_rad
        starts = np.broadcast_to(self._starts, (*pose.shape[:-2], *self._starts.shape)).copy()
        starts[..., 0] += (towards - self._starts[0, 0])[..., None]
        return starts

    def _solved(self, joints: Floats, goals: Floats, limits_rad: Floats) -> Floats:
        """Joints (K, dof) that lead to goals (K, 4, 4), from where they are; NaN where none are found."""
        open_ = np.arange(len(joints))
        found = np.full_like(joints, np.nan)
        for _ in range(STEPS):
            step = self._step(joints[open_], goals[open_], self._free)
            joints[open_] += step
            still = np.abs(step).max(axis=1, initial=0.0) >= CLOSE
            found[open_[~still]] = joints[open_[~still]]
            open_ = open_[still]
            if not len(open_):
                break
        away = np.abs(_error(self._chain.tcp_pose(np.nan_to_num(found)), goals)).max(axis=1)
        found = _within(found, limits_rad)
        found[(away > CLOSE) | ((found < limits_rad[0]) | (found > limits_rad[1])).any(axis=1)] = np.nan
        return found

    def _step(self, joints: Floats, goals: Floats, free: int) -> Floats:
        """(K, dof) rad towards the goals, of the first joints."""
        tcp, jacobian = self._chain.with_jacobian(joints)
        jacobian = jacobian[..., :free]
        error = _error(tcp, goals)
        damping = DAMPING * np.minimum(1.0, (error**2).sum(axis=1))
        square = jacobian @ np.swapaxes(jacobian, 1, 2) + (damping + 1e-12)[:, None, None] * np.eye(6)
        step = np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(square, error[..., None])
        longest = np.maximum(np.abs(step).max(axis=1, keepdims=True) / LONGEST_RAD, 1.0)
        moved = np.zeros_like(joints)
        moved[:, :free] = (step / longest)[..., 0]
        return moved

    @staticmethod
    def _known(found: Floats) -> NDArray[np.bool_]:
        """(..., STARTS) postures that an earlier start has led to."""
        away = np.abs(found[..., :, None, :] - found[..., None, :, :]).max(axis=-1)
        earlier = np.tri(found.shape[-2], k=-1, dtype=bool)
        return ((away < SAME_RAD) & earlier).any(axis=-1)


def _error(tcp: Floats, goals: Floats) -> Floats:
    """(K, 6) m and rad, in the base, from poses to goals (K, 4, 4)."""
    turns = goals[:, :3, :3] @ np.swapaxes(tcp[:, :3, :3], 1, 2)
    return np.concatenate([goals[:, :3, 3] - tcp[:, :3, 3], Rotation.from_matrix(turns).as_rotvec()], axis=1)


def _within(joints: Floats, limits_rad: Floats) -> Floats:
    """The same postures, with whole turns taken off that lead beyond the limits."""
    low, high = limits_rad
    turns = np.where(joints > high, np.ceil((joints - high) / (2 * np.pi)), 0.0)
    turns = np.where(joints < low, -np.ceil((low - joints) / (2 * np.pi)), turns)
    return joints - 2 * np.pi * turns
