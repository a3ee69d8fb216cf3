"""URDF reader: axes and limits of joints, collision shapes of links, and self-collision pairs."""

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, cast
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError
from rf_exp.robots.mounted import parent_and_child
from rf_exp.transforms import Matrix, apply, transform

if TYPE_CHECKING:
    from rf_exp.robots.robot import Robot

Element = ElementTree.Element


@dataclass(frozen=True, eq=False)
class Axis:
    """Axis of a joint."""

    direction: NDArray[np.float64]  # (3,) unit vector in the frame of the joint
    is_prismatic: bool  # otherwise revolute
    limits: tuple[float, float]  # rad, or m


@cache
def root_of(robot: "Robot") -> Element:
    """The root of the URDF. Raises ArgumentError for a file that cannot be read."""
    path = robot.urdf_path
    try:
        return ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ArgumentError(f"the URDF of robot {robot.name!r}, {path}, cannot be read: {error}") from error


@cache
def axes(robot: "Robot") -> dict[str, Axis]:
    """Joint -> its axis, for all movable joints."""
    joint_axes = {}
    for joint in root_of(robot).findall("joint"):
        if (kind := joint.attrib["type"]) not in ("revolute", "continuous", "prismatic"):
            continue
        axis, limit = joint.find("axis"), joint.find("limit")
        direction = _numbers(axis.attrib["xyz"]) if axis is not None else np.array([1.0, 0.0, 0.0])
        limits = (-2 * np.pi, 2 * np.pi)  # of continuous joints
        if kind != "continuous" and limit is not None:
            limits = float(limit.attrib.get("lower", 0.0)), float(limit.attrib.get("upper", 0.0))
        length = float(np.linalg.norm(direction))
        joint_axes[joint.attrib["name"]] = Axis(direction / length, kind == "prismatic", limits)
    return joint_axes


@cache
def solid_links(robot: "Robot") -> tuple[str, ...]:
    """The links with collision shapes."""
    links = root_of(robot).findall("link")
    return tuple(link.attrib["name"] for link in links if link.find("collision") is not None)


@cache
def hulls(robot: "Robot") -> dict[str, trimesh.Trimesh]:
    """Convex hull of the collision shapes of every solid link, in its frame, metres."""
    links = {link.get("name"): link for link in root_of(robot).findall("link")}
    folder = robot.urdf_path.parent
    link_hulls = {}
    for name in solid_links(robot):
        points = []
        for collision in links[name].iter("collision"):
            piece = shape(collision, folder, robot.name)
            if collision.find("origin") is not None:
                piece.apply_transform(placement(collision))
            points.append(piece.vertices)
        link_hulls[name] = trimesh.convex.convex_hull(np.concatenate(points))
    return link_hulls


@cache
def self_pairs(robot: "Robot") -> tuple[tuple[int, int], ...]:
    """Index pairs into the solid links that must not touch: all not excused by the SRDF beside the URDF.

    Without an SRDF, neighbours, links of the gripper, and links whose hulls overlap at rest are excused.
    """
    links = solid_links(robot)
    pairs = tuple(combinations(range(len(links)), 2))
    path = robot.urdf_path.with_suffix(".srdf")
    if path.exists():
        disabled = ElementTree.parse(path).getroot().iter("disable_collisions")
        excused = {frozenset((entry.attrib["link1"], entry.attrib["link2"])) for entry in disabled}
        return tuple((i, j) for i, j in pairs if frozenset((links[i], links[j])) not in excused)
    fingers = (robot.hand.open_m, robot.hand.open_m)
    poses = robot.link_poses(np.array([*robot.rest_rad, *fingers]))
    planes = [_planes(hulls(robot)[name], pose) for name, pose in zip(links, poses, strict=True)]
    parents = _solid_parents(robot)
    near = {frozenset(pair) for pair in (*parents.items(), *combinations(robot.gripper, 2))}
    return tuple(
        (i, j)
        for i, j in pairs
        if frozenset((links[i], links[j])) not in near and not _overlap(planes[i], planes[j])
    )


def placement(element: Element) -> Matrix:
    """Pose (4, 4) of a shape or joint in its link; angles are roll, pitch, yaw about fixed axes."""
    origin = element.find("origin")
    if origin is None:
        return transform()
    xyz, rpy = (_numbers(origin.attrib.get(key, "0 0 0")) for key in ("xyz", "rpy"))
    return transform(xyz, Rotation.from_euler("xyz", rpy))


def _numbers(text: str) -> NDArray[np.float64]:
    return np.array(text.split(), dtype=float)


def shape(element: Element, folder: Path, robot: str) -> trimesh.Trimesh:
    """The mesh of a collision or visual element, in its own frame. Raises ArgumentError for other shapes."""
    geometry = element.find("geometry")
    child = geometry[0] if geometry is not None and len(geometry) else None
    kind, attributes = (child.tag, child.attrib) if child is not None else ("nothing", {})
    if kind == "mesh":
        mesh = cast(trimesh.Trimesh, trimesh.load_mesh(folder / attributes["filename"]))
        return mesh.apply_scale(_numbers(attributes["scale"])) if "scale" in attributes else mesh
    if kind == "box":
        return trimesh.creation.box(_numbers(attributes["size"]))
    if kind == "cylinder":
        return trimesh.creation.cylinder(float(attributes["radius"]), float(attributes["length"]))
    if kind == "sphere":
        return trimesh.creation.icosphere(radius=float(attributes["radius"]))
    raise ArgumentError(f"a shape of robot {robot!r} is a {kind}; expected mesh, box, cylinder or sphere")


def _solid_parents(robot: "Robot") -> dict[str, str]:
    """Solid link -> its nearest solid ancestor; links between them have no collision shapes."""
    parent_of = {child: parent for parent, child in map(parent_and_child, root_of(robot).findall("joint"))}
    solid, solid_parents = set(solid_links(robot)), {}
    for link in solid & {*parent_of}:
        parent = parent_of[link]
        while parent not in solid and parent in parent_of:
            parent = parent_of[parent]
        if parent in solid:
            solid_parents[link] = parent
    return solid_parents


def _planes(hull: trimesh.Trimesh, pose: Matrix) -> NDArray[np.float64]:
    """Planes (F, 4) of the faces: unit normal n and offset d, with n.x <= d inside."""
    corners = apply(pose, np.asarray(hull.triangles[:, 0]))
    normals = np.asarray(hull.face_normals) @ pose[:3, :3].T
    return np.column_stack([normals, (normals * corners).sum(axis=1)])


def _overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    planes = np.concatenate([a, b])
    return linprog(np.zeros(3), planes[:, :3], planes[:, 3], bounds=(None, None)).status == 0
