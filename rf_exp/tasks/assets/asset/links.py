"""Fixed and moving links of a URDF of the authors' release, with every joint at zero."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.robots import placement
from rf_exp.texts import printable
from rf_exp.transforms import Matrix

Element = ElementTree.Element
ROTATING_JOINTS = ("revolute", "continuous")


@dataclass(frozen=True)
class Visual:
    """A visual mesh of a link."""

    path: Path
    root_from_mesh: Matrix
    scale: NDArray[np.float64]  # (3,) of its vertices


@dataclass(frozen=True)
class Axis:
    """Rotation axis of a link, in the frame of the root."""

    position: NDArray[np.float64]  # (3,)
    direction: NDArray[np.float64]  # (3,) a positive rotation about it opens the link


def read(path: Path, moving: bool) -> tuple[list[Visual], Axis | None]:
    """Visuals of the moving or of the fixed links, and the axis of the first rotating link.

    Raises ArgumentError for a file that is missing, no URDF, or has visuals other than meshes.
    """
    try:
        return _Links(path).read(moving)
    except FileNotFoundError as error:
        raise ArgumentError(f"there is no {path}; assets_folder is the release's folder `assets`") from error
    except (OSError, ElementTree.ParseError, AttributeError, KeyError, ValueError) as error:
        raise ArgumentError(
            f"URDF {path} cannot be read: {type(error).__name__} {printable(error)}"
        ) from error


class _Links:
    def __init__(self, path: Path) -> None:
        self._path, self._root = path, ElementTree.parse(path).getroot()
        self._joints = {_child(joint, "child").attrib["link"]: joint for joint in self._root.findall("joint")}

    def read(self, moving: bool) -> tuple[list[Visual], Axis | None]:
        visuals: list[Visual] = []
        axis = None
        for link in self._root.findall("link"):
            name = link.attrib["name"]
            root_from_link, is_moving = self._root_from_link(name)
            joint = self._joints.get(name)
            if axis is None and joint is not None and joint.attrib["type"] in ROTATING_JOINTS:
                axis = _axis(joint, root_from_link)
            for visual in link.findall("visual") if is_moving == moving else ():
                mesh = _child(_child(visual, "geometry"), "mesh")
                scale = np.array(mesh.attrib.get("scale", "1 1 1").split(), float)
                path = self._path.parent / mesh.attrib["filename"]
                visuals.append(Visual(path, root_from_link @ placement(visual), scale))
        return visuals, axis

    def _root_from_link(self, link: str, depth: int = 0) -> tuple[Matrix, bool]:
        """root_from_link, and whether a joint moves it."""
        if (joint := self._joints.get(link)) is None:
            return np.eye(4), False
        if depth > len(self._joints):
            raise ValueError("its joints go round in a circle")
        parent, is_moving = self._root_from_link(_child(joint, "parent").attrib["link"], depth + 1)
        return parent @ placement(joint), is_moving or joint.attrib["type"] != "fixed"


def _child(node: Element, name: str) -> Element:
    child = node.find(name)
    if child is None:
        raise ValueError(f"<{node.tag}> has no <{name}>")
    return child


def _axis(joint: Element, root_from_link: Matrix) -> Axis:
    axis, limit = joint.find("axis"), joint.find("limit")
    direction = np.array((axis.attrib["xyz"] if axis is not None else "1 0 0").split(), float)
    sign = -1.0 if limit is not None and float(limit.attrib.get("upper", 1)) <= 0 else 1.0
    return Axis(root_from_link[:3, 3], root_from_link[:3, :3] @ direction * sign)
