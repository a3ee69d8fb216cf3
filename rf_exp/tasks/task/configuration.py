"""Parses and checks the configuration of a task: plain values to a Task."""

import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import dacite
from omegaconf import OmegaConf

from rf_exp.artifacts import plain, read_values
from rf_exp.errors import ArgumentError, error_context, unknown_choice
from rf_exp.installed import CONF
from rf_exp.robots import Robot, robot_named
from rf_exp.tasks.robofactory.release_parts import (
    RELEASE,
    RELEASE_CAMERAS,
    ReleaseParts,
    split_marks,
    with_release,
)
from rf_exp.tasks.task.family import families, family_task, is_family, parse_family_name
from rf_exp.tasks.task.robots import Robots, register_robots, split_robots, with_robots
from rf_exp.tasks.task.specs import Randomisation
from rf_exp.tasks.task.start import beyond_table
from rf_exp.tasks.task.task import Task
from rf_exp.tasks.task.variation import Variation
from rf_exp.texts import printable

CONFIGURED = CONF / "task"
VARIATIONS = CONF / "variation"
MAX_TEXT_LENGTH = 2_000  # characters of a text, such as a description
_KEY = re.compile(r"[A-Za-z][\w-]{0,63}", re.ASCII)


@cache
def _defaults() -> dict[str, Any]:
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "config.yaml"))
    return node


def default_of(key: str) -> Any:
    """A fresh copy of the default of a key in conf/config.yaml, for callers other than the command line."""
    return deepcopy(_defaults()[key])


def _as_range(value: object) -> object:
    """Turns a single number into a range without width."""
    return [float(value), float(value)] if isinstance(value, int | float) else value


_CONFIG = dacite.Config(
    cast=[tuple], strict=True, type_hooks={tuple[float, float]: _as_range, Robot: robot_named}
)


def check_texts(name: str, node: object, key: str = "") -> None:
    """Raises ArgumentError for texts of a task that are not printable, too long, or contain an interpolation.

    The texts end up in pages, tables and data that others read, and Hydra could resolve a `${...}` from the
    environment. Keys have to be names.
    """
    if isinstance(node, str):
        if "${" in node:
            raise ArgumentError(
                f"task {name!r}: field {key or 'task'} is {printable(node)!r}; nothing is looked up for a "
                "task, neither in the environment nor in other keys: write the value itself"
            )
        if len(node) > MAX_TEXT_LENGTH or not node.replace("\n", " ").isprintable():
            raise ArgumentError(
                f"task {name!r}: field {key} is {printable(node)!r}, {len(node)} characters; expected "
                f"at most {MAX_TEXT_LENGTH}, all of which can be shown"
            )
        return
    if isinstance(node, Mapping):
        for inner, value in node.items():
            if not isinstance(inner, str) or not _KEY.fullmatch(inner):
                raise ArgumentError(
                    f"task {name!r}: {printable(repr(inner), 80)} in field {key or 'task'}; expected a "
                    "name: a letter, then letters, digits, '_' and '-', at most 64 of them"
                )
            check_texts(name, value, f"{key}.{inner}".lstrip("."))
    elif isinstance(node, list | tuple):
        for index, value in enumerate(node):
            check_texts(name, value, f"{key}[{index}]")


def load_task(
    name: str,
    node: Mapping,
    arms: int | None = None,
    things: int | None = None,
    robot: Robots | None = None,
    release_parts: ReleaseParts | None = None,
) -> Task:
    """The Task of a mapping of plain Python values: that below the key `<name>` of `conf/task/<name>.yaml`.

    Missing keys of randomisation have the defaults of conf/config.yaml. `arms` and `things` are the counts of
    a family, which has defaults; `robot` replaces its robots (`robots.py`), and `release_parts` replaces its
    assets and cameras by those of the authors' release.
    Raises ArgumentError that names the field for a missing or unknown field and for a wrong type; also for a
    robot or an asset that does not exist, an object relative to one not listed before it, an object that may
    start beyond the table's edge, counts that a family does not allow, and counts for a task that is none.
    """
    check_texts(name, node)
    if is_family(node):
        with error_context(f"task {name!r}"):
            name, node = family_task(name, node, arms, things)
    elif arms is not None or things is not None:
        raise ArgumentError(
            f"task {name!r} has numbers of its own; arms and things are keys of "
            f"{', '.join(families(CONFIGURED))}"
        )
    if robot is not None:
        with error_context(f"task {name!r}"):
            name, node = with_robots(name, node, robot)
    if release_parts is not None:
        with error_context(f"task {name!r}"):
            name, node = with_release(name, node, release_parts)
    with error_context(f"task {name!r}"):
        return _parsed_task(name, node)


def _parsed_task(name: str, node: Mapping) -> Task:
    """The Task of a complete configuration. Raises ArgumentError as `load_task` does."""
    if "clutter" in node:  # only drawn from a seed
        raise ArgumentError("unknown field clutter")
    register_robots(node)
    randomisation = {"randomisation": default_of("randomisation") | node.get("randomisation", {})}
    try:
        task = dacite.from_dict(Task, {**node, **randomisation}, config=_CONFIG)
    except dacite.UnexpectedDataError as error:
        raise ArgumentError(f"unknown field {', '.join(sorted(map(str, error.keys)))}") from error
    except dacite.MissingValueError as error:
        raise ArgumentError(f"field {error.field_path} is missing") from error
    except dacite.WrongTypeError as error:
        message = f"field {error.field_path} is {error.value!r}; expected {error.field_type}"
        raise ArgumentError(message) from error
    if task.name != name:
        raise ArgumentError(f"field name is {task.name!r}; expected {name!r}")
    if task.cameras["global"].mount == "wrist":
        raise ArgumentError("camera 'global' has mount 'wrist'; expected 'world': it belongs to no arm")
    for key in task.objects:
        with error_context(f"object {key!r}"):
            task.asset(key)
        if problem := _placement_error(task, key):
            raise ArgumentError(f"object {key!r} {problem}")
    return task


def _placement_error(task: Task, name: str) -> str | None:
    """An error in the placement of an object or of its hinge, as the end of a sentence; None: no error."""
    spec, hinge = task.objects[name], task.asset(name).hinge
    bearer, earlier = spec.relative_to, [*task.objects][: [*task.objects].index(name)]
    if bearer is not None and bearer not in earlier:
        return f"is relative to {bearer!r}; expected one listed before it: {earlier}"
    if hinge is None and spec.open_deg:
        return f"has no hinge, and open_deg {spec.open_deg:g}; leave it out"
    if hinge is not None:
        if not 0 <= spec.open_deg <= hinge.open_deg:
            return f"has open_deg {spec.open_deg:g}; expected 0 to {hinge.open_deg:g}"
        if bearer is None or not task.asset(bearer).static:
            return f"has a hinge; expected relative_to something that is fixed to the table, not {bearer!r}"
        if any(low != high for low, high in (spec.x_m, spec.y_m, spec.yaw_deg)):
            single = "single numbers for x_m, y_m and yaw_deg"
            return f"hangs on {bearer!r} by a hinge; expected {single}, not ranges"
    beyond_m, edge = beyond_table(task, name)
    if beyond_m > 0:
        beyond = f"{1000 * beyond_m:.0f} mm beyond the table's edge at {edge}"
        return f"may start {beyond} and fall; narrow its ranges"
    return None


def read_variation(name: str) -> Variation:
    """The Variation of conf/variation/<name>.yaml. Raises ArgumentError for one that does not exist."""
    known = sorted(path.stem for path in VARIATIONS.glob("*.yaml"))
    if name not in known:
        raise unknown_choice("variation", name, known)
    node: Any = OmegaConf.to_container(OmegaConf.load(VARIATIONS / f"{name}.yaml"))
    base, *_ = node.pop("defaults", [None])
    values = asdict(read_variation(base)) if base is not None else {}
    return read_values(Variation, values | node, "variation.")


def read_task(
    path: Path,
    arms: int | None = None,
    things: int | None = None,
    robot: Robots | None = None,
    release_parts: ReleaseParts | None = None,
) -> Task:
    """The Task of a YAML file. Raises ArgumentError as `load_task` does."""
    node: Any = OmegaConf.to_container(OmegaConf.load(path))
    return load_task(path.stem, node[path.stem], arms, things, robot, release_parts)


def named_task(name: object, folder: Path = CONFIGURED) -> Task | None:
    """The task of a name in a folder of YAML files, or None where there is none.

    The name may be a family's, as `ring` or `ring_6x2`, have other robots, as `pick_meat-ur5`, or cameras of
    the release. With assets of the release it is None: the name does not hold their folder.
    Raises ArgumentError as `load_task` does.
    """
    if not isinstance(name, str):
        return None
    files = {**families(folder), **{path.stem: path for path in folder.glob("*.yaml")}}
    if name in files:
        return read_task(files[name])
    name, marks = split_marks(name)
    if marks not in ([], [RELEASE_CAMERAS]):
        return None
    release_parts = ReleaseParts(cameras_of=RELEASE) if marks else None
    task, robots = split_robots(name)
    family, *counts = parse_family_name(task) or ("",)
    path, counts = (files[task], []) if task in files else (families(folder).get(family), counts)
    return (
        None if path is None else read_task(path, *counts, robot=robots or None, release_parts=release_parts)
    )


def stored_task(identity: Mapping[str, Any], folder: Path = CONFIGURED) -> Task:
    """The Task of a store, read from a folder of YAML files that the user has chosen.

    The attributes of a store are not trusted: they name a task and are compared with it, but do not choose
    which code or files are loaded. Raises ArgumentError for a task that is not in the folder, for one whose
    configuration differs from the store's, and for imported demonstrations.
    """
    if "imported" in identity:
        raise ArgumentError(
            "the store was imported: its scenes are somebody else's, and cannot be made again"
        )
    name, scene = identity.get("task"), identity.get("scene")
    task = named_task(name, folder)
    if task is None:
        raise unknown_choice(
            f"task of a store, in {folder}:", name, [path.stem for path in folder.glob("*.yaml")]
        )
    stored: Mapping[str, Any] = scene if isinstance(scene, Mapping) else {}
    try:  # randomisation and variation are set by the experiment, not by the file
        task = replace(task, randomisation=Randomisation(**stored["randomisation"]))
        if "variation" in stored:
            task = replace(task, variation=read_values(Variation, stored["variation"], "variation."))
    except (KeyError, TypeError) as error:
        raise ArgumentError(f"the store of {name} does not say how its scenes vary: {error}") from error
    current = plain(task.identity)
    if stored != current:
        differs = [key for key in current if stored.get(key) != current[key]]
        raise ArgumentError(
            f"the store was made of another configuration of {name} than {folder} holds; it differs in "
            f"{', '.join(differs) or 'keys that are there no more'}"
        )
    return task
