"""Messages about unknown configuration keys: the nearest known ones, and the file of the unknown one."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from importlib.resources import files as package
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from rf_exp.errors import ArgumentError
from rf_exp.installed import CONF

BASE_FILES = CONF / "config.yaml", CONF / "policy" / "paper.yaml"  # part of every configuration
RENAMED: Mapping[str, str] = yaml.safe_load(Path(__file__).with_name("renamed.yaml").read_text("utf-8"))
MIN_SIMILARITY = 0.65  # least similarity (of 1) of a suggested key: of three letters one may be wrong
MAX_LISTED = 3  # most keys in one sentence


@dataclass(frozen=True)
class File:
    """A configuration file, its Hydra package (dotted key that prefixes its keys), and its keys."""

    path: Traversable
    package: str
    keys: Collection[str]  # dotted, as the configuration has them


def refuse_unknown_keys(config: DictConfig) -> None:
    """Raises ArgumentError for unknown or missing keys in the configuration of the running job."""
    from rf_exp.keys.known import (  # slow, and needed only by jobs
        known_keys,
        missing_keys,
        possible_keys,
        replaced_mappings,
        unknown_keys,
    )

    node: Any = OmegaConf.to_container(config)
    keys = known_keys(node, _own_tasks(node))
    for key, value, below in replaced_mappings(node, keys):
        hint = f"; its value is {RENAMED[key]} now" if key in RENAMED else ""
        raise ArgumentError(f"{key} is {value!r}; expected keys below it: {', '.join(below)}{hint}")
    if unknown := list(unknown_keys(node, keys)):
        possible, files = list(possible_keys(node, keys)), composed_files()
        first, *others = (_sentence_with_file(key, possible, files) for key in unknown)
        raise ArgumentError(
            " ".join((first, *(each[0].upper() + each[1:] for each in others), key_files_sentence()))
        )
    missing = [key for path in BASE_FILES for key in missing_keys(node, config_content(path))]
    if missing:
        listed = ", ".join(missing[:MAX_LISTED]) + (" and more" if missing[MAX_LISTED:] else "")
        raise ArgumentError(
            f"the configuration lacks {listed}; a recipe begins with 'defaults: [paper, _self_]' or builds "
            "on another one, and ~KEY takes a key away"
        )


def _own_tasks(node: Mapping[str, Any]) -> dict[str, Any]:
    """The tasks of a configuration, as in their own files."""
    tasks = node["task"] if isinstance(node.get("task"), Mapping) else {}
    files = {
        name: find_config_file(f"task/{name}") or find_config_file(f"task/family/{name}") for name in tasks
    }
    return {name: config_content(path).get(name, {}) for name, path in files.items() if path is not None}


def _sentence_with_file(key: str, possible: Collection[str], files: Sequence[File]) -> str:
    file = next((file for file in reversed(files) if key in file.keys), None)
    if file is None:
        return unknown_key_sentence(key, possible, " on the command line")
    where = f" in {relative_path(file.path) if isinstance(file.path, Path) else file.path}"
    if file.package and key.removeprefix(f"{file.package}.") in possible:
        return f"there is no key {key!r}{where}: its first line must be '# @package _global_'."
    return unknown_key_sentence(key, possible, where)


def nearest(key: str, possible: Iterable[str]) -> list[str]:
    """The known keys most similar to a dotted key: of those with its parent, or else of all."""
    parent, _, last = key.rpartition(".")
    ends = {other: other.rpartition(".")[2] for other in possible}
    siblings = {other: end for other, end in ends.items() if other.rpartition(".")[0] == parent}
    if near := _most_similar(last, siblings):
        return near
    return _most_similar(
        key, {other: other for other in _most_similar(last, ends)}, 0.0
    )  # below another parent


def _most_similar(word: str, last_parts: Mapping[str, str], minimum: float = MIN_SIMILARITY) -> list[str]:
    likeness = {other: SequenceMatcher(None, word, last).ratio() for other, last in last_parts.items()}
    best = max(likeness.values(), default=0.0)
    return [other for other, value in likeness.items() if value == best >= minimum]


@cache
def keys_of_files() -> Mapping[str, str]:
    """All keys of `conf/`: dotted key -> the choice that has it, empty if every configuration has it."""
    choices = {key: "" for path in BASE_FILES for key in dotted_keys(config_content(path))}
    for group in ("task", "arch", "constraints", "brain"):
        for path in sorted((*(CONF / group).glob("*.yaml"), *(CONF / group / "family").glob("*.yaml"))):
            for key in dotted_keys(config_content(path)):
                choices.setdefault(f"{group}.{key}", f"{group}={path.stem}")
    varied = [key for key in dotted_keys(config_content(CONF / "variation" / "none.yaml")) if key != "name"]
    return choices | {f"{package}.{key}": "" for package in ("variation", "evaluated") for key in varied}


def unknown_key_sentence(key: str, possible: Iterable[str], where: str = "") -> str:
    """The sentence about an unknown key."""
    if choice := keys_of_files().get(key):
        return f"there is no key {key!r}{where}; it comes with {choice}."
    if key in RENAMED:
        return f"there is no key {key!r}{where}; it is {RENAMED[key]} now."
    near = nearest(key, possible)
    return f"there is no key {key!r}{where}" + (f"; did you mean {' or '.join(near)}?" if near else ".")


def unknown_key_message(key: str) -> str:
    """The message about a key that `conf/` does not have."""
    return f"{unknown_key_sentence(key, keys_of_files())} {key_files_sentence()}"


def key_files_sentence() -> str:
    """The sentence about where the known keys are listed."""
    files = " and ".join(relative_path(path) for path in BASE_FILES)
    tasks, scenes = relative_path(CONF / "task"), relative_path(CONF / "variation" / "none.yaml")
    return f"The keys are in {files}, those of tasks in {tasks}, those of scenes that vary in {scenes}"


def relative_path(path: Path) -> str:
    """A path for messages: relative to the current folder if it is below."""
    current_folder = Path.cwd()
    return str(path.relative_to(current_folder) if path.is_relative_to(current_folder) else path)


def composed_files() -> list[File]:
    """The configuration files of the running job, without Hydra's own; later ones take precedence."""
    hydra, loader = HydraConfig.get(), GlobalHydra.instance().config_loader()
    overrides = [*hydra.overrides.hydra, *hydra.overrides.task]
    parts = loader.compute_defaults_list(hydra.job.config_name, overrides, RunMode.RUN)
    files = []
    for part in parts.defaults:
        path = find_config_file(str(part.config_path))
        if path is not None and not str(part.config_path).startswith("hydra/"):
            prefix = f"{part.package}." if part.package else ""
            files.append(
                File(
                    path, part.package or "", {f"{prefix}{key}" for key in dotted_keys(config_content(path))}
                )
            )
    return files


def find_config_file(choice: str) -> Traversable | None:
    """The file of `group/name` in the first folder of Hydra's search path that has one."""
    roots = {"file": Path, "pkg": lambda path: package(path.replace("/", "."))}
    sources = HydraConfig.get().runtime.config_sources
    folders = (roots[each.schema](each.path) for each in sources if each.schema in roots)
    paths = (folder.joinpath(*f"{choice}.yaml".split("/")) for folder in folders)
    return next((path for path in paths if path.is_file()), None)


def config_content(path: Traversable) -> dict[str, Any]:
    """The part of a file that becomes part of the configuration."""
    node: Any = OmegaConf.to_container(OmegaConf.create(path.read_text("utf-8")))
    return {key: value for key, value in node.items() if key not in ("defaults", "hydra")}


def dotted_keys(node: Any) -> Iterator[str]:
    """Yields the dotted keys of a mapping, nested ones too."""
    for key, value in node.items() if isinstance(node, Mapping) else ():
        yield str(key)
        yield from (f"{key}.{below}" for below in dotted_keys(value))
