"""The files of which Hydra has composed a configuration, and the keys that each of them gives."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files as package
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import OmegaConf

Key = tuple[str, ...]  # its parts, outermost first


@dataclass(frozen=True)
class File:
    """One of the files, and the key below which its own ones come."""

    path: Traversable
    package: Key
    content: Mapping[str, Any]

    def at(self, key: Key) -> Any:
        """What the file says of a key of the configuration; None: nothing."""
        depth, node = len(self.package), self.content
        if key[:depth] != self.package:
            return None
        for part in key[depth:]:
            node = node.get(part) if isinstance(node, Mapping) else None
        return node

    def has(self, key: Key) -> bool:
        parent = self.at(key[:-1])
        return isinstance(parent, Mapping) and key[-1] in parent


def composed_files() -> list[File]:
    """Those of the job that runs, later ones of which win. Hydra's own are left out."""
    hydra, loader = HydraConfig.get(), GlobalHydra.instance().config_loader()
    overrides = [*hydra.overrides.hydra, *hydra.overrides.task]
    parts = loader.compute_defaults_list(hydra.job.config_name, overrides, RunMode.RUN)
    found = []
    for part in parts.defaults:
        path = found_file(str(part.config_path))
        if path is not None and not str(part.config_path).startswith("hydra/"):
            below = tuple(part.package.split(".")) if part.package else ()
            found.append(File(path, below, content(path)))
    return found


def found_file(choice: str) -> Traversable | None:
    """The file of `group/name` in the first folder of Hydra's that has one."""
    roots = {"file": Path, "pkg": lambda path: package(path.replace("/", "."))}
    sources = HydraConfig.get().runtime.config_sources
    folders = (roots[each.schema](each.path) for each in sources if each.schema in roots)
    paths = (folder.joinpath(*f"{choice}.yaml".split("/")) for folder in folders)
    return next((path for path in paths if path.is_file()), None)


def content(path: Traversable) -> dict[str, Any]:
    """What a file gives to the configuration."""
    node: Any = OmegaConf.to_container(OmegaConf.create(path.read_text("utf-8")))
    return {key: value for key, value in node.items() if key not in ("defaults", "hydra")}


def inner(node: Any) -> Iterator[str]:
    """The dotted keys of a mapping, inner ones too."""
    for key, value in node.items() if isinstance(node, Mapping) else ():
        yield str(key)
        yield from (f"{key}.{below}" for below in inner(value))
