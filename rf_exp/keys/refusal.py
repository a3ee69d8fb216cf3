"""What is said of the keys that a configuration cannot have: the nearest ones, and where they stand."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from rf_exp.errors import ArgumentError
from rf_exp.keys.files import File, Key, composed_files, content, found_file
from rf_exp.keys.likeness import ALWAYS, RENAMED, keys_are_in, no_key, shown

LISTED = 3  # keys in one sentence


def refuse_unknown_keys(config: DictConfig) -> None:
    """Raises ArgumentError for keys that the configuration of the job that runs has too many, or lacks."""
    from rf_exp.keys.known import absent, flat, known, possible, unknown  # slow: only where there is a job

    node: Any = OmegaConf.to_container(config)
    keys = known(node, _own_tasks(node))
    for key, value, below in flat(node, keys):
        moved = f"; {RENAMED[key]} is what it was" if key in RENAMED else ""
        raise ArgumentError(f"{key} is {value!r}; expected keys below it: {', '.join(below)}{moved}")
    if found := list(unknown(node, keys)):
        there, files = list(possible(node, keys)), composed_files()
        first, *others = (_told(key, there, files) for key in found)
        raise ArgumentError(
            " ".join((first, *(each[0].upper() + each[1:] for each in others), keys_are_in()))
        )
    lacking = [key for path in ALWAYS for key in absent(node, content(path))]
    if lacking:
        listed = ", ".join(lacking[:LISTED]) + (" and more" if lacking[LISTED:] else "")
        raise ArgumentError(
            f"the configuration lacks {listed}; a recipe begins with 'defaults: [paper, _self_]' or builds "
            "on another one, and ~KEY takes a key away"
        )


def _own_tasks(node: Mapping[str, Any]) -> dict[str, Any]:
    """The tasks of a configuration as their own files have them."""
    named = node["task"] if isinstance(node.get("task"), Mapping) else {}
    files = {name: found_file(f"task/{name}") for name in named}
    return {name: content(path).get(name, {}) for name, path in files.items() if path is not None}


def _told(key: Key, there: Collection[str], files: Sequence[File]) -> str:
    """A sentence about a key that is not there."""
    said = ".".join(map(str, key))
    file = next((file for file in reversed(files) if file.has(key)), None)
    if file is None:
        return no_key(said, there, " on the command line")
    where = f" in {shown(file.path) if isinstance(file.path, Path) else file.path}"
    if file.package and ".".join(map(str, key[len(file.package) :])) in there:
        return f"there is no key {said!r}{where}: its first line must be '# @package _global_'."
    return no_key(said, there, where)
