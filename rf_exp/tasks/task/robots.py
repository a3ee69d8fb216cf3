"""Replacement of a task's robots by one model for all arms, `robot=ur5`, or one per arm, `robot=[panda,ur5]`.

Such a task is called `<name>-<robot>`, or `<name>-<robot>-<robot>` with one per arm. Everything else is the
task's, except that a base moves forward by as much as its robot reaches less far than the replaced one.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.robots import DEFAULT, known_robots, robot_named
from rf_exp.texts import printable

Robots = str | Sequence[str]
ROBOT_SEPARATOR = "-"  # in names, between a task and its robots
MODULES = "rf_exp.tasks"


def register_robots(node: Mapping[str, Any], names: Sequence[Any] = ()) -> None:
    """Imports the task's `code` where a robot is not registered yet: that module may register it."""
    robots, code = node.get("robots", ()), node.get("code")
    models = {robot.get("model", DEFAULT.name) for robot in robots if isinstance(robot, Mapping)}
    if isinstance(code, str) and not {*models, *names} <= {robot.name for robot in known_robots()}:
        import_module(code)


def with_robots(name: str, node: Mapping[str, Any], robots: Robots) -> tuple[str, Mapping[str, Any]]:
    """Name and configuration of a task with other robots; unchanged for the robots that it has.

    Raises ArgumentError for unknown robots, and for a list whose length is not the number of arms.
    """
    names = list(robots) if isinstance(robots, Sequence) and not isinstance(robots, str) else [robots]
    entries = node.get("robots", ())
    if len(names) not in (1, len(entries)):
        raise ArgumentError(
            f"robot is {printable(str(robots))}; expected one for all arms, or a list of {len(entries)}"
        )
    register_robots(node, names)
    known = [robot.name for robot in known_robots()]
    for model in names:
        if model not in known:
            raise unknown_choice("robot", printable(str(model)), known)
    models = names * len(entries) if len(names) == 1 else names
    if models == [robot.get("model", DEFAULT.name) for robot in entries]:
        return name, node
    names = list(dict.fromkeys(names)) if len({*names}) == 1 else names
    task_name = ROBOT_SEPARATOR.join([name, *names])
    return task_name, {
        **node,
        "name": task_name,
        "title": f"{node['title']} ({', '.join(names)})",
        "robots": [_with_model(entry, model) for entry, model in zip(entries, models, strict=True)],
        "code": node.get("code") or f"{MODULES}.{name}",
    }


def split_robots(name: str) -> tuple[str, list[str]]:
    """(task, robots) of the name of a task with other robots: one model for all arms, or one per arm."""
    task, *robots = name.split(ROBOT_SEPARATOR)
    return task, robots


def _with_model(entry: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The entry of an arm with another robot: base moved, rest posture of the new robot."""
    if name == entry.get("model", DEFAULT.name):
        return dict(entry)
    old, new = robot_named(entry.get("model", DEFAULT.name)), robot_named(name)
    forward_m, yaw_rad = old.reach_m - new.reach_m, np.deg2rad(entry["yaw_deg"])
    placed = {key: value for key, value in entry.items() if key != "rest_rad"}
    x_m, y_m = entry["x_m"] + forward_m * np.cos(yaw_rad), entry["y_m"] + forward_m * np.sin(yaw_rad)
    return placed | {"model": name, "x_m": round(float(x_m), 6), "y_m": round(float(y_m), 6)}
