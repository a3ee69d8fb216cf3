"""URDFs of robots: where they lie, and those that are made of an arm's and of another robot's hand.

A hand that is not its maker's is screwed to the flange of an arm. The URDF of both together, with copies of
the meshes that it needs, is made once and kept in a cache folder. Names in it are relative: the same parts
give the same bytes on every machine.
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

PACKAGED = "package://"  # and the name of a Python package: a path within it
DISTRIBUTED = "distribution://"  # and the name of what pip installs: a path as its wheel has it
REMEDY = "set XDG_CACHE_HOME to a writable folder"
SQUARE_RAD = 1e-5  # nearer than this to a quarter turn an angle is one: makers write 1.5708
LAYOUT = 1  # raise when the way of making the files changes

Element = ElementTree.Element
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Mounted:
    """An arm with the hand of another robot."""

    arm: str  # its URDF, as `Robot.urdf` names one
    flange: str  # the link that bears the hand
    hand: str  # the URDF of the robot with the hand
    root: str  # the link of the hand that is screwed to the flange; all behind it come along
    rpy: Vector = (0.0, 0.0, 0.0)  # rad, by which it is turned there
    without: tuple[str, ...] = ()  # links of the arm that make way
    extra: str = ""  # of this package, that brings the URDFs

    @property
    def path(self) -> Path:
        """The URDF of both. Raises StageError where a part is missing, and where it cannot be kept."""
        return _made(self)


def located(urdf: str | Path, extra: str = "") -> Path:
    """The file. Raises StageError where the package that it lies in is not installed."""
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
    """Where what is made of robots is kept. Raises StageError for a user without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rf_exp"
    except RuntimeError as error:
        raise StageError(f"there is no place for the mesh cache: {error}; {REMEDY}") from error


def cached(path: Path, what: str, make: Callable[[Path], None]) -> Path:
    """A file of the cache, of whose folder `make` fills a draft where it is missing.

    Raises StageError where it cannot be written.
    """
    if not os.access(path, os.R_OK):
        try:
            with whole(path.parent) as draft:
                draft.mkdir()
                make(draft)
        except OSError as error:
            # Of several processes that make it the first wins, the others find it complete.
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
    """One tree of both; meshes are called as their makers do. What is no link and no joint is left out."""
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
    """The links of these names, and the joints between them."""
    for each in root:
        if (each.tag == "link" and each.attrib["name"] in links) or (
            each.tag == "joint" and {*ends(each)} <= links
        ):
            yield each


def _behind(root: Element, link: str) -> set[str]:
    """A link and all that hang on it. Raises ArgumentError where there is no such link."""
    if link not in {each.attrib["name"] for each in root.findall("link")}:
        raise ArgumentError(f"the URDF of {root.get('name')!r} has no link {link!r}")
    found = {link}
    while grown := {child for parent, child in map(ends, root.findall("joint")) if parent in found} - found:
        found |= grown
    return found


def ends(joint: Element) -> tuple[str, str]:
    """The links that a joint lies between."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None  # URDF asks for both
    return parent.attrib["link"], child.attrib["link"]


def _meshes(root: Element, arm: Path, hand: Path) -> Iterator[tuple[str, Path, Element]]:
    """The name that it gets, where it lies, and the element, of each mesh; scenes with colours become GLB."""
    for kind in ("visual", "collision"):
        for mesh in root.iterfind(f"link/{kind}/geometry/mesh"):
            said = mesh.attrib["filename"]
            source = next((path for urdf in (arm, hand) if (path := _source(said, urdf)).exists()), None)
            if source is None:
                raise ArgumentError(f"mesh {said!r} lies beside neither {arm} nor {hand}")
            suffix = ".glb" if source.suffix == ".dae" else source.suffix
            yield f"{kind}/{source.stem}{suffix}", source, mesh


def _source(said: str, urdf: Path) -> Path:
    """Where a mesh lies: `package://` is of ROS here, a folder of that name above the URDF."""
    if not said.startswith(PACKAGED):
        return urdf.parent / said
    package, _, path = said.removeprefix(PACKAGED).partition("/")
    return next((above for above in urdf.parents if above.name == package), urdf.parent / package) / path


def _keep(source: Path, copy: Path, mounted: Mounted) -> None:
    """A copy of a mesh, or what a Collada scene becomes."""
    copy.parent.mkdir(exist_ok=True)
    if source.suffix != ".dae":
        shutil.copyfile(source, copy)
        return
    if find_spec("collada") is None:
        raise _missing("pycollada", mounted.extra)
    import trimesh

    trimesh.load(source, force="scene").export(copy)
