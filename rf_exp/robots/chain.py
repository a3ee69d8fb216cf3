"""Forward kinematics of a robot, for many postures at once, from its URDF as Pinocchio reads it."""

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, choices
from rf_exp.robots import urdf
from rf_exp.transforms import from_axes
from rf_exp.types import fingers_of

if TYPE_CHECKING:
    from rf_exp.robots.robot import Finger, Inverse, Robot

Floats = NDArray[np.float64]


@cache
def chain_of(robot: "Robot") -> "Chain":
    """The chain of a robot, made once."""
    return Chain(robot)


@cache
def solver_of(robot: "Robot") -> "Inverse":
    """The inverse kinematics of a robot, made once."""
    return robot.inverse(robot)


class Chain:
    """The joints of a robot, each after its parent. Joints of neither arm nor hand stay where they are.

    Raises ArgumentError for a URDF without the frames and joints that the robot names, and for one whose
    arm has other joints than revolute ones, or not as many as the robot says.
    """

    def __init__(self, robot: "Robot") -> None:
        model = pin.buildModelFromUrdf(str(robot.urdf_path))
        names, parents = tuple(model.names), tuple(model.parents)
        frames = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
        for frame in (robot.hand.tcp, robot.hand.link, *(finger.link for finger in robot.hand.fingers)):
            if frame not in frames:
                raise choices(f"link of robot {robot.name!r}", frame, frames)
        self._axes = urdf.axes(robot)
        self._tcp = frames[robot.hand.tcp].parentJoint
        self._arm: list[int] = []  # from the base to the TCP
        joint = self._tcp
        while joint:
            self._arm.insert(0, joint)
            joint = parents[joint]
        first, last = self._arm[0], self._arm[-1]  # NumPy is faster along slices
        row = len(self._arm) == last + 1 - first
        self._turning = slice(first, last + 1) if row else self._arm
        found = tuple(names[joint] for joint in self._arm)
        if found != robot.joints or any(self._axes[name].slides for name in found):
            raise ArgumentError(
                f"robot {robot.name!r} has the joints {', '.join(found)} between its base and "
                f"{robot.hand.tcp}; expected revolute ones: {', '.join(robot.joints)}"
            )
        self.limits_rad = np.array([self._axes[name].limits for name in found]).T
        for joint in (joint for finger in robot.hand.fingers for joint in finger.joints):
            if joint not in names:
                raise choices(f"joint of the hand of robot {robot.name!r}", joint, names[1:])
        self._turned = list[tuple[int, int, "Finger"]]()  # joints of fingers that turn, and which finger
        self._slid = list[tuple[int, int, "Finger", int, float]]()  # those that slide, along which axes
        for k, finger in enumerate(robot.hand.fingers):
            for joint in finger.joints:
                axis, number = self._axes[joint], names.index(joint)
                if not axis.slides:
                    self._turned.append((number, k, finger))
                for along in np.flatnonzero(axis.direction) if axis.slides else ():
                    self._slid.append((number, k, finger, int(along), float(axis.direction[along])))
        # Each revolute joint turns about the z axis of a frame of its own, so all of them are alike.
        turns = [
            np.eye(4) if axis is None or axis.slides else _z_along(axis.direction)
            for axis in (self._axes.get(name) for name in names)
        ]
        self._parents = parents
        self._placements = [
            turns[parent].T @ placement.homogeneous @ turns[joint]
            for joint, (parent, placement) in enumerate(zip(parents, model.jointPlacements, strict=True))
        ]
        links = [frames[name] for name in (*robot.links, robot.hand.tcp)]
        self._joint_of = np.array([frame.parentJoint for frame in links])
        self._from_joint = np.stack(
            [turns[frame.parentJoint].T @ frame.placement.homogeneous for frame in links]
        )

    @property
    def dof(self) -> int:
        return len(self._arm)

    def link_poses(self, qpos: NDArray[np.floating]) -> Floats:
        """Base-frame poses (..., L, 4, 4) of the links for measured joints (..., D)."""
        poses = self._poses(np.asarray(qpos, dtype=float), range(1, len(self._parents)))
        return poses[..., self._joint_of[:-1], :, :] @ self._from_joint[:-1]

    def tcp_pose(self, joints: NDArray[np.floating]) -> Floats:
        """base_from_tcp (..., 4, 4); fingers do not move it."""
        poses = self._poses(np.asarray(joints, dtype=float), self._arm)
        return poses[..., self._tcp, :, :] @ self._from_joint[-1]

    def with_jacobian(self, joints: Floats) -> tuple[Floats, Floats]:
        """base_from_tcp (..., 4, 4), and (..., 6, dof) by how much it moves, m and rad, with each joint."""
        poses = self._poses(joints, self._arm)
        tcp = poses[..., self._tcp, :, :] @ self._from_joint[-1]
        arm = poses[..., self._arm, :, :]
        axes = arm[..., :3, 2]  # (..., dof, 3)
        moved = np.cross(axes, tcp[..., None, :3, 3] - arm[..., :3, 3])
        return tcp, np.swapaxes(np.concatenate([moved, axes], axis=-1), -1, -2)

    def _poses(self, qpos: Floats, chain: Sequence[int]) -> Floats:
        """(..., joints + 1, 4, 4) base_from_joint of a chain; 0 is the base. Others are not filled in."""
        motions = np.zeros((*qpos.shape[:-1], len(self._parents), 4, 4))
        motions[..., range(4), range(4)] = 1.0
        _turn(motions, self._turning, qpos[..., : self.dof])
        if len(chain) > self.dof:
            fingers = fingers_of(qpos)
            for joint, k, finger, along, share in self._slid:
                motions[..., joint, along, 3] = share * finger.position(fingers[..., k])
            for joint, k, finger in self._turned:
                _turn(motions, joint, finger.position(fingers[..., k]))
        poses = np.empty_like(motions)
        poses[..., 0, :, :] = np.eye(4)
        for joint in chain:
            parent = poses[..., self._parents[joint], :, :]
            poses[..., joint, :, :] = parent @ self._placements[joint] @ motions[..., joint, :, :]
        return poses


def _turn(motions: Floats, joints: int | slice | list[int], angles_rad: Floats) -> None:
    """Turns joints by their angles, each about its own z."""
    motions[..., joints, 0, 0] = motions[..., joints, 1, 1] = np.cos(angles_rad)
    motions[..., joints, 1, 0] = np.sin(angles_rad)
    motions[..., joints, 0, 1] = -motions[..., joints, 1, 0]


def _z_along(direction: Floats) -> Floats:
    """(4, 4) that turns the z axis there; nothing for the z axis itself."""
    if np.array_equal(direction, (0.0, 0.0, 1.0)):
        return np.eye(4)
    square = np.eye(3)[np.abs(direction).argmin()]
    return from_axes((0.0, 0.0, 0.0), z=direction, y=square)
