"""Families: tasks whose numbers of arms and of objects (`things`) are keys: `task=ring arms=6 things=2`.

A family is `conf/task/family/<name>.yaml`, with counts `arms` and `things` and parameters of a `layout` in
place of robots, objects and cameras, and a module with `layout(arms, things, ...)`, which returns these,
beside the contents of any task's module (`task.py`). Its tasks are called `<name>_<arms>x<things>`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from rf_exp.artifacts import read_values
from rf_exp.errors import ArgumentError

FOLDER = "family"  # below the folder of the tasks
MODULES = "rf_exp.tasks.families"
_MEMBER = re.compile(r"(?P<family>\w+?)_(?P<arms>\d+)x(?P<things>\d+)")


@dataclass(frozen=True)
class Count:
    """A count of a family: its default and its bounds."""

    usual: int
    least: int
    most: int

    def resolve(self, key: str, value: int | None) -> int:
        """The given number, or the default for None. Raises ArgumentError for one out of bounds."""
        number = self.usual if value is None else value
        allowed = f"{self.least} to {self.most}" if self.least < self.most else f"{self.most}"
        if type(number) is not int:
            raise ArgumentError(f"{key} is {number!r}; expected a number from {allowed}")
        if not self.least <= number <= self.most:
            raise ArgumentError(f"{key} is {number}; expected {allowed}")
        return number


COUNT_FIELDS = tuple(item.name for item in fields(Count))


def is_family(node: Mapping[str, Any]) -> bool:
    """Whether a configuration is that of a family."""
    return "layout" in node


def family_task(
    name: str, node: Mapping[str, Any], arms: int | None = None, things: int | None = None
) -> tuple[str, dict[str, Any]]:
    """Name and configuration of the task of a family with these counts.

    Raises ArgumentError for counts out of bounds.
    """
    counts = {key: read_values(Count, node.get(key, {}), f"{key}.") for key in ("arms", "things")}
    numbers = {key: counts[key].resolve(key, count) for key, count in (("arms", arms), ("things", things))}
    code = node.get("code") or f"{MODULES}.{name}"
    try:
        layout = import_module(code).layout(**numbers, **node["layout"])
    except TypeError as error:
        raise ArgumentError(f"layout: {error}") from error
    task_name = f"{name}_{numbers['arms']}x{numbers['things']}"
    title = f"{node['title']} {numbers['arms']} x {numbers['things']}"
    rest = {key: value for key, value in node.items() if key not in ("arms", "things", "layout")}
    return task_name, {**rest, **layout, "name": task_name, "title": title, "code": code}


def parse_family_name(name: str) -> tuple[str, int, int] | None:
    """(family, arms, things) of the name of a family's task; None for any other name."""
    match = _MEMBER.fullmatch(name)
    return (match["family"], int(match["arms"]), int(match["things"])) if match else None


def families(folder: Path) -> dict[str, Path]:
    """Family -> its file, in a folder of tasks."""
    return {path.stem: path for path in sorted((folder / FOLDER).glob("*.yaml"))}
