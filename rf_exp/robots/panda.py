"""The Franka Emika Panda without a simulator: forward and inverse kinematics, link volumes.

The model is read from the URDF and meshes that ManiSkill's package ships, so that planner,
checker and simulator speak of the same robot.
"""

from functools import cache
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from rf_exp.errors import StageError
from rf_exp.robots.postures import postures, upright_rad
from rf_exp.transforms import Matrix, inverse, transform, wrapped_rad

ARM_JOINTS = 7
LINKS = (*(f"panda_link{i}" for i in range(8)), "panda_hand", "panda_leftfinger", "panda_rightfinger")
TCP = "panda_hand_tcp"


def description_folder() -> Path:
    """The folder with ManiSkill's Panda files, found without importing ManiSkill."""
    spec = find_spec("mani_skill")
    if spec is None or not spec.submodule_search_locations:
        raise StageError("the package mani-skill is not installed; run `make setup`")
    return Path(spec.submodule_search_locations[0]) / "assets" / "robots" / "panda"


@cache
def _model() -> pin.Model:
    return pin.buildModelFromUrdf(str(description_folder() / "panda_v2.urdf"))


def limits_rad() -> NDArray[np.float64]:
    """(2, 7) lower and upper joint limits of the arm."""
    model = _model()
    return np.stack([model.lowerPositionLimit[:ARM_JOINTS], model.upperPositionLimit[:ARM_JOINTS]])


@cache
def _frames() -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Parent joint (L + 1,) and joint_from_link (L + 1, 4, 4) of every link in LINKS, then the TCP."""
    model = _model()
    ids = [model.getFrameId(name) for name in (*LINKS, TCP)]
    joints = np.array([model.frames[i].parentJoint for i in ids])
    return joints, np.stack([model.frames[i].placement.homogeneous for i in ids])


@cache
def _chain() -> tuple[tuple[int, ...], tuple[NDArray[np.float64], ...]]:
    """Parent of every joint, and parent_from_joint (4, 4) at zero; asking Pinocchio each time is slow."""
    model = _model()
    return tuple(model.parents), tuple(placement.homogeneous for placement in model.jointPlacements)


def _joint_poses(qpos: NDArray[np.floating], last: int = 9) -> NDArray[np.float64]:
    """(..., last + 1, 4, 4) base_from_joint; index 0 is the base. Vectorised over leading axes."""
    parents, placements = _chain()
    motions = np.zeros((*qpos.shape[:-1], 10, 4, 4))
    motions[..., range(4), range(4)] = 1.0
    arm = motions[..., 1 : ARM_JOINTS + 1, :, :]  # revolute, each about its own z
    arm[..., 0, 0] = arm[..., 1, 1] = np.cos(qpos[..., :ARM_JOINTS])
    arm[..., 1, 0] = np.sin(qpos[..., :ARM_JOINTS])
    arm[..., 0, 1] = -arm[..., 1, 0]
    if last > ARM_JOINTS:  # fingers slide along their y, towards opposite sides
        motions[..., 8, 1, 3], motions[..., 9, 1, 3] = qpos[..., 7], -qpos[..., 8]
    poses = np.empty((*qpos.shape[:-1], last + 1, 4, 4))
    poses[..., 0, :, :] = np.eye(4)
    for joint in range(1, last + 1):
        parent = poses[..., parents[joint], :, :]
        poses[..., joint, :, :] = parent @ placements[joint] @ motions[..., joint, :, :]
    return poses


def link_poses(qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Base-frame poses of LINKS for joint positions (..., 9) rad and metres: (..., L, 4, 4)."""
    joints, placements = _frames()
    return _joint_poses(np.asarray(qpos, dtype=float))[..., joints[:-1], :, :] @ placements[:-1]


def tcp_pose(qpos: NDArray[np.floating]) -> NDArray[np.float64]:
    """base_from_tcp (..., 4, 4) for arm joints (..., 7) rad; z out of the hand, y along the fingers."""
    joints, placements = _frames()
    last = int(joints[-1])  # of the arm: fingers do not move it
    return _joint_poses(np.asarray(qpos, dtype=float), last)[..., last, :, :] @ placements[-1]


@cache
def hulls() -> dict[str, trimesh.Trimesh]:
    """Convex hull of the collision shapes of every link in LINKS, in the frame of the link, metres."""
    folder = description_folder()
    links = {link.get("name"): link for link in ElementTree.parse(folder / "panda_v2.urdf").iter("link")}
    return {name: _hull(links[name], folder) for name in LINKS}


def _hull(link: ElementTree.Element, folder: Path) -> trimesh.Trimesh:
    points = []
    for collision in link.iter("collision"):
        mesh, box = collision.find("geometry/mesh"), collision.find("geometry/box")
        if mesh is not None:
            shape = trimesh.load_mesh(folder / mesh.attrib["filename"])
        else:
            assert box is not None, f"{link.get('name')}: neither mesh nor box"
            shape = trimesh.creation.box(np.array(box.attrib["size"].split(), dtype=float))
        origin = collision.find("origin")
        if origin is not None:
            rotation = Rotation.from_euler("xyz", np.array(origin.attrib["rpy"].split(), dtype=float))
            shape.apply_transform(transform(np.array(origin.attrib["xyz"].split(), dtype=float), rotation))
        points.append(shape.vertices)
    return trimesh.convex.convex_hull(np.concatenate(points))


@cache
def self_pairs() -> tuple[tuple[int, int], ...]:
    """Index pairs into LINKS whose contact is a self-collision: all that the SRDF does not excuse."""
    root = ElementTree.parse(description_folder() / "panda_v2.srdf")
    excused = {frozenset((e.attrib["link1"], e.attrib["link2"])) for e in root.iter("disable_collisions")}
    pairs = combinations(range(len(LINKS)), 2)
    return tuple((i, j) for i, j in pairs if frozenset((LINKS[i], LINKS[j])) not in excused)


_MARGIN_RAD = 0.02  # to the limits of joints, of postures that are planned
_AWAY_RAD = np.linspace(-5.6, 5.6, 57)  # of the last joint
NEIGHBOUR_RAD = 0.35  # postures nearer than this in every joint are on one branch


class Panda:
    """One arm bolted to the table at `world_from_base` (4, 4)."""

    def __init__(self, world_from_base: Matrix) -> None:
        self.world_from_base = world_from_base
        self._base_from_world = inverse(world_from_base)

    def tcp(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """world_from_tcp (..., 4, 4) for arm joints (..., 7 or 9) rad."""
        return self.world_from_base @ tcp_pose(np.asarray(qpos)[..., :ARM_JOINTS])

    def links(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """World poses of LINKS (..., L, 4, 4) for joint positions (..., 9)."""
        return self.world_from_base @ link_poses(qpos)

    def postures(self, world_from_tcp: NDArray[np.float64], last_rad: ArrayLike) -> NDArray[np.float64]:
        """All joints (..., BRANCHES, 7) rad for TCP poses (..., 4, 4) and the last joint (...).

        Within the joint limits and a small margin; NaN where there is no such posture.
        """
        limits = limits_rad() + np.array([[_MARGIN_RAD], [-_MARGIN_RAD]])
        return postures(self._base_from_world @ world_from_tcp, last_rad, limits)

    def facing(self, world_from_tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles (...) rad of the last joint that put the arm into an upright plane at TCP poses (..., 4, 4).

        Where none is so, the one with which it would be if the tool pointed straight down.
        """
        pose = self._base_from_world @ world_from_tcp
        away = pose[..., :2, 3] / np.linalg.norm(pose[..., :2, 3], axis=-1, keepdims=True)
        ahead = np.einsum("...i,...ij->...j", away, pose[..., :2, :2])
        return wrapped_rad(upright_rad(pose, np.pi / 4 - np.arctan2(ahead[..., 1], ahead[..., 0])))

    def solve(self, world_from_tcp: Matrix, near_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joints (7,) rad that put the TCP at a pose, near to `near_rad` (7,); None where there are none.

        The last joint stays as it is where a neighbouring posture allows that, so along a path of near poses
        the joints go smoothly; otherwise it is the nearest posture of a range of them.
        """
        last = near_rad[ARM_JOINTS - 1]
        for turns, farthest in (([last], NEIGHBOUR_RAD), (last + _AWAY_RAD, np.inf)):
            found = self.postures(world_from_tcp, turns).reshape(-1, ARM_JOINTS)
            away = np.abs(found - near_rad[:ARM_JOINTS]).max(axis=1)
            nearest = int(np.nan_to_num(away, nan=np.inf).argmin())
            if away[nearest] < farthest:
                return found[nearest]
        return None
