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

from rf_exp.artifacts import whole
from rf_exp.errors import ArgumentError, StageError

PACKAGED = "package://"  # followed by NAME/PATH: a path in a Python package
DISTRIBUTED = "distribution://"  # followed by NAME/PATH: a path in the wheel of a pip distribution
REMEDY = "set XDG_CACHE_HOME to a writable folder"
SQUARE_RAD = 1e-5  # angles closer than this to a quarter turn are rounded to it: URDFs have 1.5708
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
        return _made(self)


def located(urdf: str | Path, extra: str = "") -> Path:
    """Path of a URDF. Raises StageError where the package that contains it is not installed."""
    said = str(urdf)
    scheme = next((each for each in (PACKAGED, DISTRIBUTED) if said.startswith(each)), None)
    if scheme is None:
        return Path(said)
    package, _, path = said.removeprefix(scheme).partition("/")
    with suppress(PackageNotFoundError):
        if scheme == DISTRIBUTED:
            return Path(str(distribution(package).locate_file(path)))
        spec = find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            return Path(spec.submodule_search_locations[0]) / path
    raise _missing(package.replace("_", "-"), extra)


def cache_home() -> Path:
    """The cache folder for files built from robots. Raises StageError for a user without a home folder."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rf_exp"
    except RuntimeError as error:
        raise StageError(f"there is no place for the mesh cache: {error}; {REMEDY}") from error


def cached(path: Path, what: str, make: Callable[[Path], None]) -> Path:
    """A file in the cache; where it is missing, `make` fills a draft of its folder.

    Raises StageError where it cannot be written.
    """
    if not os.access(path, os.R_OK):
        try:
            with whole(path.parent) as draft:
                draft.mkdir()
                make(draft)
        except OSError as error:
            # If several processes build it, the first wins and the others find it complete.
            if not os.access(path, os.R_OK):
                raise StageError(f"cannot write the {what}: {error.strerror or error}; {REMEDY}") from error
    return path


def _missing(package: str, extra: str) -> StageError:
    remedy = f"run: pip install 'rf_exp[{extra}]'" if extra else "run `make setup`"
    return StageError(f"the package {package} is not installed; {remedy}")


@cache
def _made(mounted: Mounted) -> Path:
    arm, hand = located(mounted.arm, mounted.extra), located(mounted.hand, mounted.extra)
    root = _joined(mounted, arm, hand)
    sources = {name: source for name, source, _ in _meshes(root, arm, hand)}
    digest = hashlib.sha256(repr((LAYOUT, mounted)).encode() + ElementTree.tostring(root))
    for name, source in sorted(sources.items()):
        digest.update(name.encode() + source.read_bytes())
    target = cache_home() / digest.hexdigest()[:16] / f"{root.attrib['name']}.urdf"

    def make(draft: Path) -> None:
        for name, source in sources.items():
            _keep(source, draft / name, mounted)
        for name, _, mesh in _meshes(root, arm, hand):
            mesh.set("filename", name)
        ElementTree.ElementTree(root).write(draft / target.name)

    return cached(target, f"URDF {target}", make)


def _joined(mounted: Mounted, arm: Path, hand: Path) -> Element:
    """Tree of both URDFs with the original mesh names; only links and joints are kept."""
    above, below = (ElementTree.parse(path).getroot() for path in (arm, hand))
    root = Element("robot", name=f"{above.attrib['name']}_{mounted.root}")
    root.extend(_kept(above, {link.attrib["name"] for link in above.findall("link")} - {*mounted.without}))
    if mounted.flange not in {link.attrib["name"] for link in root.findall("link")}:
        raise ArgumentError(f"{arm} has no link {mounted.flange!r} for a hand to be screwed to")
    screwed = ElementTree.SubElement(root, "joint", name=f"{mounted.root}_mount", type="fixed")
    ElementTree.SubElement(screwed, "parent", link=mounted.flange)
    ElementTree.SubElement(screwed, "child", link=mounted.root)
    ElementTree.SubElement(screwed, "origin", xyz="0 0 0", rpy=" ".join(map(repr, mounted.rpy)))
    root.extend(map(deepcopy, _kept(below, _behind(below, mounted.root))))
    for origin in root.iter("origin"):
        angles = np.array(origin.get("rpy", "0 0 0").split(), dtype=float)
        quarters = np.round(angles / (np.pi / 2)) * (np.pi / 2)
        square = np.where(np.abs(angles - quarters) < SQUARE_RAD, quarters, angles)
        origin.set("rpy", " ".join(repr(float(each)) for each in square))
    return root


def _kept(root: Element, links: set[str]) -> Iterator[Element]:
    """The links with these names, and the joints between them."""
    for each in root:
        if (each.tag == "link" and each.attrib["name"] in links) or (
            each.tag == "joint" and {*ends(each)} <= links
        ):
            yield each


def _behind(root: Element, link: str) -> set[str]:
    """A link and its descendants. Raises ArgumentError where there is no such link."""
    if link not in {each.attrib["name"] for each in root.findall("link")}:
        raise ArgumentError(f"the URDF of {root.get('name')!r} has no link {link!r}")
    found = {link}
    while grown := {child for parent, child in map(ends, root.findall("joint")) if parent in found} - found:
        found |= grown
    return found


def ends(joint: Element) -> tuple[str, str]:
    """The parent and the child link of a joint."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None  # required by URDF
    return parent.attrib["link"], child.attrib["link"]


def _meshes(root: Element, arm: Path, hand: Path) -> Iterator[tuple[str, Path, Element]]:
    """New name, source file and element of each mesh; Collada scenes become GLB.

    Raises ArgumentError for a mesh that does not exist.
    """
    for kind in ("visual", "collision"):
        for mesh in root.iterfind(f"link/{kind}/geometry/mesh"):
            said = mesh.attrib["filename"]
            source = next((path for urdf in (arm, hand) if (path := _source(said, urdf)).exists()), None)
            if source is None:
                raise ArgumentError(f"mesh {said!r} lies beside neither {arm} nor {hand}")
            suffix = ".glb" if source.suffix == ".dae" else source.suffix
            yield f"{kind}/{source.stem}{suffix}", source, mesh


def _source(said: str, urdf: Path) -> Path:
    """Path of a mesh. `package://` has ROS's meaning here: a folder of that name above the URDF."""
    if not said.startswith(PACKAGED):
        return urdf.parent / said
    package, _, path = said.removeprefix(PACKAGED).partition("/")
    return next((above for above in urdf.parents if above.name == package), urdf.parent / package) / path


def _keep(source: Path, copy: Path, mounted: Mounted) -> None:
    """Copies a mesh; converts Collada scenes. Raises StageError where pycollada is not installed for that."""
    copy.parent.mkdir(exist_ok=True)
    if source.suffix != ".dae":
        shutil.copyfile(source, copy)
        return
    if find_spec("collada") is None:
        raise _missing("pycollada", mounted.extra)
    import trimesh

    trimesh.load(source, force="scene").export(copy)
