"""Releases: published policies to be evaluated, with an experiment that says how they were trained.

    python -m rf_exp.run --config-dir FILE.zip experiment=released
    python -m rf_exp.run --config-dir FOLDER experiment=released out=FOLDER

A file is unpacked into a folder of its name beside it, which is `out` as well. The folder is treated as data:
Hydra, whose files may name code to be run, never reads it. A short list of keys of the experiment is read,
checked, and inserted before the user's own arguments, which take precedence.
`scripts/release.py` writes a release.
"""

import argparse
import json
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from rf_exp.artifacts import atomic_path, leaves, plain, restored
from rf_exp.errors import ArgumentError
from rf_exp.policy import PolicyConfig, TrainConfig

CHOICE, EXPERIMENT = "experiment", Path("experiment/released.yaml")
NAME = EXPERIMENT.stem
GROUPS = ("task", "constraints", "arch")
STAGES = ("evaluate", "report")
MAX_EXPERIMENT_BYTES = 2**16  # bytes of the experiment's file
SUFFIX, MAX_UNPACKED_BYTES = ".zip", 2**26  # suffix of a release's file; most bytes in it, unpacked
_WORD = re.compile(r"[A-Za-z0-9][\w.+-]{0,99}", re.ASCII)  # of a task, constraint set, architecture, recipe


@dataclass(frozen=True)
class PictureSize:
    """The size of the policies' pictures, px."""

    width: int
    height: int


@dataclass(frozen=True)
class ReleaseConfig:
    """The only keys that the experiment of a release may set. Raises ArgumentError for invalid values."""

    defaults: tuple[Mapping[str, str], ...]
    stages: tuple[str, ...]
    recipe: str
    demos: int
    train_seed: int
    disturbance_rad: float
    delay_s: float
    picture: PictureSize
    policy: Mapping[str, Any]
    training: Mapping[str, Any]

    def __post_init__(self) -> None:
        expected = [f"override /{group}" for group in GROUPS]
        keys = [key for each in self.defaults for key in each]
        if keys != expected:
            raise ArgumentError(f"defaults are {keys}; expected {expected}")
        for key, value in {**self._chosen, "recipe": self.recipe}.items():
            if not isinstance(value, str) or not _WORD.fullmatch(value):
                raise ArgumentError(
                    f"{key} is {value!r}; expected a name: letters, digits, '_', '-', '+', '.'"
                )
        if not self.stages or not set(STAGES).issuperset(self.stages):
            raise ArgumentError(f"stages are {list(self.stages)}; possible are {', '.join(STAGES)}")
        limits = {"demos": 10**6, "train_seed": 2**32 - 1, "disturbance_rad": 1.0, "delay_s": 60.0}
        for key, high in limits.items():
            value, low = getattr(self, key), int(key == "demos")
            if isinstance(value, bool) or not low <= value <= high:
                raise ArgumentError(f"{key} is {value}; expected {low} to {high:g}")

    @property
    def overrides(self) -> list[str]:
        """The experiment as command-line overrides, without how a training runs, which changes nothing."""
        policy = PolicyConfig.read(self.policy, asdict(self.picture)).complete
        training = TrainConfig.read(self.training)
        options = "stages", "recipe", "demos", "train_seed", "disturbance_rad", "delay_s"
        values = {key: getattr(self, key) for key in options}
        values |= {f"picture.{side}": policy.pop(side) for side in ("width", "height")}
        values |= leaves(policy, "policy")
        values |= {f"training.{key}": value for key, value in training.identity.items() if key != "seed"}
        chosen = [f"{group}={value}" for group, value in self._chosen.items()]
        # JSON values are valid in Hydra's grammar.
        return chosen + [f"{k}={json.dumps(v, ensure_ascii=False)}" for k, v in plain(values).items()]

    @property
    def _chosen(self) -> dict[str, str]:
        return dict(
            zip(GROUPS, (value for default in self.defaults for value in default.values()), strict=True)
        )


def expand_release(arguments: Sequence[str]) -> list[str]:
    """The arguments of a command, a release replaced by the overrides of its experiment.

    Raises ArgumentError for a release that sets anything else, and where its folder is not named.
    """
    if not any(_is_release(each) for each in arguments):
        return list(arguments)
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--config-dir", "-cd", type=Path)
    try:
        parsed, others = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError as error:
        raise ArgumentError(f"{error}; a release is named by --config-dir FOLDER {CHOICE}={NAME}") from error
    if parsed.config_dir is None or f"{CHOICE}={NAME}" not in others:
        raise ArgumentError(
            f"{CHOICE}={NAME} is a release, which is read from a folder, alone: "
            f"--config-dir FOLDER {CHOICE}={NAME}"
        )
    others.remove(f"{CHOICE}={NAME}")
    user_keys = {each.partition("=")[0].lstrip("+~") for each in others}
    folder = parsed.config_dir
    if folder.suffix == SUFFIX and folder.is_file():
        folder = unzip(folder)
        others += [] if "out" in user_keys else [f"out={folder}"]
    overrides = read_release(folder).overrides
    kept = [each for each in overrides if each.partition("=")[0] not in user_keys]
    position = next(
        (k for k, each in enumerate(others) if "=" in each and not each.startswith("-")), len(others)
    )
    return [*others[:position], *kept, *others[position:]]


def unzip(path: Path) -> Path:
    """The folder beside a release's file with its content; unpacks the file unless the folder exists.

    Raises ArgumentError for a file that is no ZIP archive or holds more than a release may.
    """
    folder = path.with_suffix("")
    if folder.exists():
        return folder
    try:
        with zipfile.ZipFile(path) as archive, atomic_path(folder) as draft:
            if (size := sum(each.file_size for each in archive.infolist())) > MAX_UNPACKED_BYTES:
                raise ArgumentError(f"{path} holds {size} bytes; a release has at most {MAX_UNPACKED_BYTES}")
            archive.extractall(draft)  # never outside of it, whatever names say, and no links
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise ArgumentError(f"{path} cannot be unpacked: {error}") from error
    return folder


def read_release(folder: Path) -> ReleaseConfig:
    """The experiment of a release, checked. Raises ArgumentError for any other content."""
    path = folder / EXPERIMENT
    for part in (folder / "policies", folder / "results", folder / EXPERIMENT.parent):
        for each in (part, *part.rglob("*")):  # through links, files elsewhere would be read or written
            if each.is_symlink() and not each.resolve().is_relative_to(folder.resolve()):
                raise ArgumentError(f"{each} is a link out of the release; it holds files of its own")
    try:
        content = path.read_bytes()[: MAX_EXPERIMENT_BYTES + 1]
        if len(content) > MAX_EXPERIMENT_BYTES:
            raise ValueError(f"it has more than {MAX_EXPERIMENT_BYTES} bytes")
        config = yaml.load(content.decode("utf-8"), _Values)
        if not isinstance(config, dict):
            raise ValueError(f"it holds a {type(config).__name__}, not keys")
        known = [each.name for each in fields(ReleaseConfig)]
        if unknown := [key for key in config if key not in known]:
            raise ValueError(f"it sets {unknown[0]!r}; a release says {', '.join(known)}, and nothing else")
        release = restored(ReleaseConfig, config)
        _ = release.overrides  # raises for values that no policy can have
        return release
    except (OSError, ValueError, RecursionError, yaml.YAMLError, ArgumentError) as error:
        raise ArgumentError(f"{path} is no experiment of a release: {error}") from error


class _Values(yaml.SafeLoader):
    """YAML loader of plain values without aliases, whose expansion could fill the memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"it refers to itself, {self.peek_event().start_mark}")
        return super().compose_node(parent, index)


def _is_release(argument: str) -> bool:
    """Whether an argument chooses a release, in any spelling of Hydra."""
    key, _, value = argument.partition("=")
    return key.lstrip("+~").partition("@")[0].strip("/ ") == CHOICE and NAME in re.split(r"\W+", value)
