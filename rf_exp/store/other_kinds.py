"""What a path holds that is no store of this project: a store of another kind, a file, any other folder.

Told by its layout, without decoding a value of it, so that nothing sound is ever called damaged.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rf_exp.errors import StageError

OURS = ("identity", "control_hz")  # attributes that stores of other kinds lack
OUR_ARRAY = "meta/certificate"  # and a folder that they lack
BUFFER = {"data/action", "meta/episode_ends"}  # arrays that a replay buffer of Diffusion Policy has
SHOWN = 8  # arrays that are named
FILES = {b"\x89HDF\r\n\x1a\n": "an HDF5 file", b"PK\x03\x04": "a ZIP archive", b"\x80": "a pickle"}


def refuse_other_kinds(path: Path) -> None:
    """Raises StageError for anything but a store of this project, whole or damaged."""
    try:
        if not path.exists():
            raise StageError(
                f"no store at {path}; generate the data first (stages=[generate]), or name the folder of "
                "one, such as outputs/data/.../fast.zarr"
            )
        what = other_kind(path)
    except OSError as error:
        raise StageError(f"{path} cannot be read: {error.strerror or error}") from error
    if what:
        raise StageError(
            f"{path} is {what}; nothing is wrong with it, but it is no store of rf_exp; expected the folder "
            "of one as stages=[generate] makes it, such as outputs/data/.../fast.zarr"
        )


def other_kind(path: Path) -> str:
    """What is there, in words; empty for a store of this project, whole or damaged."""
    if not path.is_dir():
        return _file(path)
    if (path / "zarr.json").is_file():
        return _zarr_3(path)
    for name, node in ((".zgroup", "group"), (".zarray", "array"), (".zmetadata", "group")):
        if (path / name).is_file():
            return _zarr(2, node, path, ".zarray")
    if (path / OUR_ARRAY).is_dir():
        return ""  # its zarr.json is lost
    version = _json(path / "meta/info.json").get("codebase_version")
    if isinstance(version, str):
        return f"a LeRobot data set of version {version}"
    return _folder(path)


def _file(path: Path) -> str:
    with path.open("rb") as file:
        begins = file.read(8)
    return next((what for magic, what in FILES.items() if begins.startswith(magic)), "a file")


def _zarr_3(path: Path) -> str:
    said = _json(path / "zarr.json")
    if not said or _is_ours(said) or (path / OUR_ARRAY).is_dir():
        return ""  # what cannot be read may have been one of ours
    if _is_ours(_json(path.parent / "zarr.json")):
        return f"a part of the store {path.parent}"
    return _zarr(3, "array" if said.get("node_type") == "array" else "group", path, "zarr.json")


def _zarr(version: int, node: str, path: Path, file: str) -> str:
    found = dict(_arrays(path, file)) if node == "group" else {}
    kind = ", laid out as a replay buffer of Diffusion Policy" if found.keys() >= BUFFER else ""
    named = ", ".join(f"{name} {shape}" for name, shape in list(found.items())[:SHOWN])
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return f"a Zarr {version} {node}{kind}{f' ({named}{more})' if found else ''}"


def _arrays(group: Path, file: str) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Name and shape of the arrays of a group and of its groups."""
    for path in sorted([*group.glob(f"*/{file}"), *group.glob(f"*/*/{file}")]):
        shape = _json(path).get("shape")
        if isinstance(shape, list):
            yield path.parent.relative_to(group).as_posix(), tuple(shape)


def _is_ours(said: dict[str, Any]) -> bool:
    """Whether the metadata of a group have attributes of ours."""
    attributes = said.get("attributes")
    return isinstance(attributes, dict) and any(name in attributes for name in OURS)


def _folder(path: Path) -> str:
    within = sorted(each.name for each in path.iterdir())
    if not within:
        return "an empty folder"
    stores = [name for name in within if name.endswith(".zarr")]
    if stores:
        return f"a folder of {len(stores)} stores ({', '.join(stores[:SHOWN])})"
    return f"a folder without zarr.json ({', '.join(within[:SHOWN])}{', ...' if len(within) > SHOWN else ''})"


def _json(file: Path) -> dict[str, Any]:
    """The object in a JSON file; empty where there is none."""
    try:
        found = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
