"""URDFs of robots: their paths, and combinations of an arm with the gripper of another robot.

The URDF of such a combination, with copies of the meshes that it needs, is built once and kept in a cache
folder. Mesh paths in it are relative: the same parts give the same bytes on every machine.
"""

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from rf_exp.artifacts import atomic_path
from rf_exp.errors import ArgumentError, StageError

PACKAGE_SCHEME = "package://"  # followed by NAME/PATH: a path in a Python package
DISTRIBUTION_SCHEME = "distribution://"  # followed by NAME/PATH: a path in the wheel of a pip distribution
REMEDY = "set XDG_CACHE_HOME to a writable folder"
QUARTER_TURN_TOLERANCE_RAD = (
    1e-5  # angles closer than this to a quarter turn are rounded to it: URDFs have 1.5708
)
LAYOUT = 1  # raise when the way of building the files changes

Element = ElementTree.Element
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Mounted:
    """An arm with the gripper of another robot."""

    arm: str  # its URDF, in the notation of `Robot.urdf`
    flange: str  # the arm's link that carries the gripper
    hand: str  # the URDF of the robot with the gripper
    root: str  # the gripper's link at the flange; its descendants are included
    rpy: Vector = (0.0, 0.0, 0.0)  # rad, rotation of `root` at the flange
    without: tuple[str, ...] = ()  # links of the arm to remove
    extra: str = ""  # extra of this package that installs the URDFs

    @property
    def path(self) -> Path:
        """The combined URDF.

        Raises StageError where a package is not installed or the file cannot be written, and ArgumentError
        where a link or a mesh is missing.
        """
        return _combined_urdf(self)


def resolve_urdf(urdf: str | Path, extra: str = "") -> Path:
    """Path of a URDF. Raises StageError where the package that contains it is not installed."""
    address = str(urdf)
    scheme = next(
        (prefix for prefix in (PACKAGE_SCHEME, DISTRIBUTION_SCHEME) if address.startswith(prefix)), None
    )
    if scheme is None:
        return Path(address)
    package, _, path = address.removeprefix(scheme).partition("/")
    with suppress(PackageNotFoundError):
        if scheme == DISTRIBUTION_SCHEME:
            return Path(str(distribution(package).locate_file(path)))
        spec = find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            return Path(spec.submodule_search_locations[0]) / path
    raise _not_installed(package.replace("_", "-"), extra)


def cache_home() -> Path:
    """The cache folder for files built from robots. Raises StageError for a user without a home folder."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rf_exp"
    except RuntimeError as error:
        raise StageError(f"there is no place for the mesh cache: {error}; {REMEDY}") from error


def build_cached(path: Path, description: str, make: Callable[[Path], None]) -> Path:
    """A file in the cache; where it is missing, `make` fills a draft of its folder.

    Raises StageError where it cannot be written.
    """
    if not os.access(path, os.R_OK):
        try:
            with atomic_path(path.parent) as draft:
                draft.mkdir()
                make(draft)
        except OSError as error:
            # If several processes build it, the first wins and the others find it complete.
            if not os.access(path, os.R_OK):
                raise StageError(
                    f"cannot write the {description}: {error.strerror or error}; {REMEDY}"
                ) from error
    return path


def _not_installed(package: str, extra: str) -> StageError:
    remedy = f"run: pip install 'rf_exp[{extra}]'" if extra else "run `make setup`"
    return StageError(f"the package {package} is not installed; {remedy}")


@cache
def _combined_urdf(mounted: Mounted) -> Path:
    arm_urdf, hand_urdf = resolve_urdf(mounted.arm, mounted.extra), resolve_urdf(mounted.hand, mounted.extra)
    root = _combined_tree(mounted, arm_urdf, hand_urdf)
    sources = {name: source for name, source, _ in _meshes(root, arm_urdf, hand_urdf)}
    digest = hashlib.sha256(repr((LAYOUT, mounted)).encode() + ElementTree.tostring(root))
    for name, source in sorted(sources.items()):
        digest.update(name.encode() + source.read_bytes())
    target = cache_home() / digest.hexdigest()[:16] / f"{root.attrib['name']}.urdf"

    def make(draft: Path) -> None:
        for name, source in sources.items():
            _copy_mesh(source, draft / name, mounted)
        for name, _, mesh in _meshes(root, arm_urdf, hand_urdf):
            mesh.set("filename", name)
        ElementTree.ElementTree(root).write(draft / target.name)

    return build_cached(target, f"URDF {target}", make)


def _combined_tree(mounted: Mounted, arm_urdf: Path, hand_urdf: Path) -> Element:
    """Tree of both URDFs with the original mesh names; only links and joints are kept."""
    arm_root, hand_root = (ElementTree.parse(path).getroot() for path in (arm_urdf, hand_urdf))
    root = Element("robot", name=f"{arm_root.attrib['name']}_{mounted.root}")
    root.extend(
        _links_and_joints(
            arm_root, {link.attrib["name"] for link in arm_root.findall("link")} - {*mounted.without}
        )
    )
    if mounted.flange not in {link.attrib["name"] for link in root.findall("link")}:
        raise ArgumentError(f"{arm_urdf} has no link {mounted.flange!r} to mount the hand on")
    mount = ElementTree.SubElement(root, "joint", name=f"{mounted.root}_mount", type="fixed")
    ElementTree.SubElement(mount, "parent", link=mounted.flange)
    ElementTree.SubElement(mount, "child", link=mounted.root)
    ElementTree.SubElement(mount, "origin", xyz="0 0 0", rpy=" ".join(map(repr, mounted.rpy)))
    root.extend(map(deepcopy, _links_and_joints(hand_root, _descendants(hand_root, mounted.root))))
    for origin in root.iter("origin"):
        angles = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
        quarters = np.round(angles / (np.pi / 2)) * (np.pi / 2)
        rounded = np.where(np.abs(angles - quarters) < QUARTER_TURN_TOLERANCE_RAD, quarters, angles)
        origin.set("rpy", " ".join(repr(float(angle)) for angle in rounded))
    return root


def _links_and_joints(root: Element, links: set[str]) -> Iterator[Element]:
    """The links with these names, and the joints between them."""
    for element in root:
        if (element.tag == "link" and element.attrib["name"] in links) or (
            element.tag == "joint" and {*parent_and_child(element)} <= links
        ):
            yield element


def _descendants(root: Element, link: str) -> set[str]:
    """A link and its descendants. Raises ArgumentError where there is no such link."""
    if link not in {element.attrib["name"] for element in root.findall("link")}:
        raise ArgumentError(f"the URDF of {root.get('name')!r} has no link {link!r}")
    descendants = {link}
    while (
        children := {
            child for parent, child in map(parent_and_child, root.findall("joint")) if parent in descendants
        }
        - descendants
    ):
        descendants |= children
    return descendants


def parent_and_child(joint: Element) -> tuple[str, str]:
    """The parent and the child link of a joint."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None  # required by URDF
    return parent.attrib["link"], child.attrib["link"]


def _meshes(root: Element, arm_urdf: Path, hand_urdf: Path) -> Iterator[tuple[str, Path, Element]]:
    """New name, source file and element of each mesh; Collada scenes become GLB.

    Raises ArgumentError for a mesh that does not exist.
    """
    for kind in ("visual", "collision"):
        for mesh in root.iterfind(f"link/{kind}/geometry/mesh"):
            filename = mesh.attrib["filename"]
            source = next(
                (
                    candidate
                    for urdf in (arm_urdf, hand_urdf)
                    if (candidate := _mesh_path(filename, urdf)).exists()
                ),
                None,
            )
            if source is None:
                raise ArgumentError(f"there is no mesh {filename!r} relative to {arm_urdf} or {hand_urdf}")
            suffix = ".glb" if source.suffix == ".dae" else source.suffix
            yield f"{kind}/{source.stem}{suffix}", source, mesh


def _mesh_path(filename: str, urdf: Path) -> Path:
    """Path of a mesh. `package://` has ROS's meaning here: a folder of that name above the URDF."""
    if not filename.startswith(PACKAGE_SCHEME):
        return urdf.parent / filename
    package, _, path = filename.removeprefix(PACKAGE_SCHEME).partition("/")
    return next((above for above in urdf.parents if above.name == package), urdf.parent / package) / path


def _copy_mesh(source: Path, copy: Path, mounted: Mounted) -> None:
    """Copies a mesh; converts Collada scenes. Raises StageError where pycollada is not installed for that."""
    copy.parent.mkdir(exist_ok=True)
    if source.suffix != ".dae":
        shutil.copyfile(source, copy)
        return
    if find_spec("collada") is None:
        raise _not_installed("pycollada", mounted.extra)
    import trimesh

    trimesh.load(source, force="scene").export(copy)
