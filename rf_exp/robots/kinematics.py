"""Kinematics of a robot: forward from its URDF, inverse by damped Newton steps from several starts.

Both are vectorised over postures. The Newton steps work for any arm with six or seven revolute joints. They
are slower than a closed form and incomplete: postures that no start converges to are not found. The starts
are the rest posture and postures drawn once about it within the limits, all turned towards the pose. For
a redundant arm the last joint is given.
"""

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.robots import urdf
from rf_exp.transforms import from_axes
from rf_exp.types import fingers_of

if TYPE_CHECKING:
    from rf_exp.robots.robot import Finger, Inverse, Robot

Floats = NDArray[np.float64]

STARTS = 8
STEPS = 60
MAX_STEP_RAD = 0.5  # largest change of a joint in a step
DAMPING = 1e-3
TOLERANCE = 1e-8  # m and rad, tolerance of convergence
DUPLICATE_RAD = 1e-4  # postures closer than this are the same


@cache
def solver_of(robot: "Robot") -> "Inverse":
    """The inverse kinematics of a robot, cached."""
    return (robot.inverse or Numeric)(robot)


class Chain:
    """Forward kinematics of a robot. Joints that belong to neither arm nor gripper are fixed at zero.

    Raises ArgumentError for a URDF without the frames and joints that the robot names, and for one whose
    arm has joints that are not revolute, or other joints than the robot names.
    """

    def __init__(self, robot: "Robot") -> None:
        model = pin.buildModelFromUrdf(str(robot.urdf_path))
        names, parents = tuple(model.names), tuple(model.parents)
        frames = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
        for frame in (robot.hand.tcp, robot.hand.link, *(finger.link for finger in robot.hand.fingers)):
            if frame not in frames:
                raise unknown_choice(f"link of robot {robot.name!r}", frame, frames)
        self._axes = urdf.axes(robot)
        self._tcp = frames[robot.hand.tcp].parentJoint
        self._arm: list[int] = []  # from the base to the TCP
        joint = self._tcp
        while joint:
            self._arm.insert(0, joint)
            joint = parents[joint]
        self.dof = len(self._arm)
        first, last = self._arm[0], self._arm[-1]  # NumPy is faster with slices
        contiguous = len(self._arm) == last + 1 - first
        self._revolute = slice(first, last + 1) if contiguous else self._arm
        joint_names = tuple(names[joint] for joint in self._arm)
        if joint_names != robot.joints or any(self._axes[name].is_prismatic for name in joint_names):
            raise ArgumentError(
                f"robot {robot.name!r} has the joints {', '.join(joint_names)} between its base and "
                f"{robot.hand.tcp}; expected revolute ones: {', '.join(robot.joints)}"
            )
        self.limits_rad = np.array([self._axes[name].limits for name in joint_names]).T
        for joint in (joint for finger in robot.hand.fingers for joint in finger.joints):
            if joint not in names:
                raise unknown_choice(f"joint of the hand of robot {robot.name!r}", joint, names[1:])
        self._revolute_fingers = list[tuple[int, int, "Finger"]]()  # revolute finger joints, and their finger
        self._prismatic_fingers = list[
            tuple[int, int, "Finger", int, float]
        ]()  # prismatic ones, with axis components
        for k, finger in enumerate(robot.hand.fingers):
            for joint in finger.joints:
                axis, index = self._axes[joint], names.index(joint)
                if not axis.is_prismatic:
                    self._revolute_fingers.append((index, k, finger))
                for component in np.flatnonzero(axis.direction) if axis.is_prismatic else ():
                    self._prismatic_fingers.append(
                        (index, k, finger, int(component), float(axis.direction[component]))
                    )
        # Frames are rotated so that every revolute joint turns about z, and all are computed alike.
        rotations = [
            np.eye(4) if axis is None or axis.is_prismatic else _z_along(axis.direction)
            for axis in (self._axes.get(name) for name in names)
        ]
        self._parents = parents
        self._placements = [
            rotations[parent].T @ placement.homogeneous @ rotations[joint]
            for joint, (parent, placement) in enumerate(zip(parents, model.jointPlacements, strict=True))
        ]
        links = [frames[name] for name in (*robot.links, robot.hand.tcp)]
        self._joint_of = np.array([frame.parentJoint for frame in links])
        self._from_joint = np.stack(
            [rotations[frame.parentJoint].T @ frame.placement.homogeneous for frame in links]
        )

    def link_poses(self, qpos: NDArray[np.floating]) -> Floats:
        """Base-frame poses (..., L, 4, 4) of the links for measured joints (..., D)."""
        poses = self._poses(np.asarray(qpos, dtype=float), range(1, len(self._parents)))
        return poses[..., self._joint_of[:-1], :, :] @ self._from_joint[:-1]

    def tcp_pose(self, joints: NDArray[np.floating]) -> Floats:
        """base_from_tcp (..., 4, 4), independent of the fingers."""
        poses = self._poses(np.asarray(joints, dtype=float), self._arm)
        return poses[..., self._tcp, :, :] @ self._from_joint[-1]

    def with_jacobian(self, joints: Floats) -> tuple[Floats, Floats]:
        """base_from_tcp (..., 4, 4), and its geometric Jacobian (..., 6, dof) in m and rad per rad."""
        poses = self._poses(joints, self._arm)
        tcp = poses[..., self._tcp, :, :] @ self._from_joint[-1]
        arm = poses[..., self._arm, :, :]
        axes = arm[..., :3, 2]  # (..., dof, 3)
        moved = np.cross(axes, tcp[..., None, :3, 3] - arm[..., :3, 3])
        return tcp, np.swapaxes(np.concatenate([moved, axes], axis=-1), -1, -2)

    def _poses(self, qpos: Floats, chain: Sequence[int]) -> Floats:
        """base_from_joint (..., joints + 1, 4, 4), 0 being the base; only joints of `chain` are filled in."""
        motions = np.zeros((*qpos.shape[:-1], len(self._parents), 4, 4))
        motions[..., range(4), range(4)] = 1.0
        _set_rotation(motions, self._revolute, qpos[..., : self.dof])
        if len(chain) > self.dof:
            fingers = fingers_of(qpos)
            for joint, k, finger, component, scale in self._prismatic_fingers:
                motions[..., joint, component, 3] = scale * finger.position(fingers[..., k])
            for joint, k, finger in self._revolute_fingers:
                _set_rotation(motions, joint, finger.position(fingers[..., k]))
        poses = np.empty_like(motions)
        poses[..., 0, :, :] = np.eye(4)
        for joint in chain:
            parent = poses[..., self._parents[joint], :, :]
            poses[..., joint, :, :] = parent @ self._placements[joint] @ motions[..., joint, :, :]
        return poses


chain_of = cache(Chain)  # one per robot


def _set_rotation(motions: Floats, joints: int | slice | list[int], angles_rad: Floats) -> None:
    motions[..., joints, 0, 0] = motions[..., joints, 1, 1] = np.cos(angles_rad)
    motions[..., joints, 1, 0] = np.sin(angles_rad)
    motions[..., joints, 0, 1] = -motions[..., joints, 1, 0]


def _z_along(direction: Floats) -> Floats:
    """Rotation (4, 4) of the z axis to a direction; identity for the z axis itself."""
    if np.array_equal(direction, (0.0, 0.0, 1.0)):
        return np.eye(4)
    perpendicular = np.eye(3)[np.abs(direction).argmin()]
    return from_axes((0.0, 0.0, 0.0), z=direction, y=perpendicular)


class Numeric:
    """Numerical `rf_exp.robots.Inverse`. Branch k is the posture found from start k, unless found earlier."""

    def __init__(self, robot: "Robot") -> None:
        self.branches, self.opposite_branch = STARTS, np.arange(STARTS)
        self._chain, self._free = chain_of(robot), 6  # number of joints to solve for
        low, high = self._chain.limits_rad
        rest = np.array(robot.rest_rad)
        near = np.clip(rest + np.random.default_rng(0).uniform(-1.5, 1.5, (STARTS, robot.dof)), low, high)
        self._starts = np.concatenate([rest[None], near[1:]])
        x, y = self._chain.tcp_pose(rest)[:2, 3]
        self._ahead_rad = float(np.arctan2(y, x)) - rest[0]  # of the TCP at rest, from the first joint

    def postures(self, base_from_tcp: Floats, last_rad: ArrayLike, limits_rad: Floats) -> Floats:
        pose, last = np.asarray(base_from_tcp, dtype=float), np.asarray(last_rad, dtype=float)
        redundant = self._chain.dof > self._free
        shape = np.broadcast_shapes(pose.shape[:-2], last.shape)
        goals = np.broadcast_to(pose, (*shape, 4, 4)) if redundant else pose
        starts = np.broadcast_to(self._starts_towards(goals), (*goals.shape[:-2], *self._starts.shape)).copy()
        if redundant:
            starts[..., -1] = np.broadcast_to(last, shape)[..., None]
        flat = starts.reshape(-1, self._chain.dof)
        flat_goals = np.broadcast_to(goals[..., None, :, :], (*starts.shape[:-1], 4, 4)).reshape(-1, 4, 4)
        solutions = self._solve(flat, flat_goals, limits_rad).reshape(starts.shape)
        # Remove postures that an earlier start has found.
        difference_rad = np.abs(solutions[..., :, None, :] - solutions[..., None, :, :]).max(axis=-1)
        solutions[((difference_rad < DUPLICATE_RAD) & np.tri(STARTS, k=-1, dtype=bool)).any(axis=-1)] = np.nan
        return np.broadcast_to(solutions, (*shape, *solutions.shape[-2:])).copy()

    def preferred_last_rad(self, base_from_tcp: Floats) -> Floats:
        """See `Inverse`: the last joint of the posture reached from rest, turned towards the pose."""
        pose = np.asarray(base_from_tcp, dtype=float)
        start = self._starts_towards(pose)[..., 0, :]
        if self._chain.dof == self._free:
            return start[..., -1]
        joints, goals = start.reshape(-1, start.shape[-1]).copy(), pose.reshape(-1, 4, 4)
        for _ in range(STEPS):
            joints += self._step(joints, goals, self._chain.dof)
        low, high = self._chain.limits_rad[:, -1]
        return np.clip(joints[:, -1], low, high).reshape(start.shape[:-1])

    def _starts_towards(self, pose: Floats) -> Floats:
        """Starts (..., STARTS, dof) with the first joint turned towards poses (..., 4, 4)."""
        towards = np.arctan2(pose[..., 1, 3], pose[..., 0, 3]) - self._ahead_rad
        starts = np.broadcast_to(self._starts, (*pose.shape[:-2], *self._starts.shape)).copy()
        starts[..., 0] += (towards - self._starts[0, 0])[..., None]
        return starts

    def _solve(self, joints: Floats, goals: Floats, limits_rad: Floats) -> Floats:
        """Joints (K, dof) for goals (K, 4, 4), from the starts `joints` (K, dof); NaN where not found."""
        active = np.arange(len(joints))
        solutions = np.full_like(joints, np.nan)
        for _ in range(STEPS):
            step = self._step(joints[active], goals[active], self._free)
            joints[active] += step
            moving = np.abs(step).max(axis=1, initial=0.0) >= TOLERANCE
            solutions[active[~moving]] = joints[active[~moving]]
            active = active[moving]
            if not len(active):
                break
        error = np.abs(_error(self._chain.tcp_pose(np.nan_to_num(solutions)), goals)).max(axis=1)
        low, high = limits_rad
        turns = np.where(solutions > high, np.ceil((solutions - high) / (2 * np.pi)), 0.0)
        turns = np.where(solutions < low, -np.ceil((low - solutions) / (2 * np.pi)), turns)
        solutions -= 2 * np.pi * turns  # whole turns, back into the limits
        solutions[(error > TOLERANCE) | ((solutions < low) | (solutions > high)).any(axis=1)] = np.nan
        return solutions

    def _step(self, joints: Floats, goals: Floats, free: int) -> Floats:
        """Damped Newton step (K, dof) in rad towards the goals, of the first `free` joints."""
        tcp, jacobian = self._chain.with_jacobian(joints)
        jacobian = jacobian[..., :free]
        error = _error(tcp, goals)
        damping = DAMPING * np.minimum(1.0, (error**2).sum(axis=1))
        square = jacobian @ np.swapaxes(jacobian, 1, 2) + (damping + 1e-12)[:, None, None] * np.eye(6)
        step = np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(square, error[..., None])
        longest = np.maximum(np.abs(step).max(axis=1, keepdims=True) / MAX_STEP_RAD, 1.0)
        moved = np.zeros_like(joints)
        moved[:, :free] = (step / longest)[..., 0]
        return moved


def _error(tcp: Floats, goals: Floats) -> Floats:
    """Error (K, 6) in m and rad, in the base frame, from poses to goals (K, 4, 4)."""
    turns = goals[:, :3, :3] @ np.swapaxes(tcp[:, :3, :3], 1, 2)
    return np.concatenate([goals[:, :3, 3] - tcp[:, :3, 3], Rotation.from_matrix(turns).as_rotvec()], axis=1)
