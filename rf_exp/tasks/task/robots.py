"""Replacement of a task's robots by one model for all arms, `robot=ur5`, or one per arm, `robot=[panda,ur5]`.

Such a task is called `<name>-<robot>`, or `<name>-<robot>-<robot>` with one per arm. Everything else is the
task's, except that a base moves forward by as much as its robot reaches less far than the replaced one.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from rf_exp.errors import ArgumentError, choices
from rf_exp.robots import DEFAULT, known_robots, robot_named
from rf_exp.texts import printable

Robots = str | Sequence[str]
MARK = "-"  # in names, between a task and its robots
MODULES = "rf_exp.tasks"


def find_robots(node: Mapping[str, Any], names: Sequence[Any] = ()) -> None:
    """Imports the task's `code` where a robot is not registered yet: that module may register it."""
    robots, code = node.get("robots", ()), node.get("code")
    said = {robot.get("model", DEFAULT.name) for robot in robots if isinstance(robot, Mapping)}
    if isinstance(code, str) and not {*said, *names} <= {robot.name for robot in known_robots()}:
        import_module(code)


def with_robots(name: str, node: Mapping[str, Any], robots: Robots) -> tuple[str, Mapping[str, Any]]:
    """Name and configuration of a task with other robots; unchanged for the robots that it has.

    Raises ArgumentError for unknown robots, and for a list whose length is not the number of arms.
    """
    names = list(robots) if isinstance(robots, Sequence) and not isinstance(robots, str) else [robots]
    placed = node.get("robots", ())
    if len(names) not in (1, len(placed)):
        raise ArgumentError(
            f"robot is {printable(str(robots))}; expected one for all arms, or a list of {len(placed)}"
        )
    find_robots(node, names)
    known = [robot.name for robot in known_robots()]
    for each in names:
        if each not in known:
            raise choices("robot", printable(str(each)), known)
    each_arm = names * len(placed) if len(names) == 1 else names
    if each_arm == [robot.get("model", DEFAULT.name) for robot in placed]:
        return name, node
    names = list(dict.fromkeys(names)) if len({*names}) == 1 else names
    called = MARK.join([name, *names])
    return called, {
        **node,
        "name": called,
        "title": f"{node['title']} ({', '.join(names)})",
        "robots": [_placed(line, each) for line, each in zip(placed, each_arm, strict=True)],
        "code": node.get("code") or f"{MODULES}.{name}",
    }


def parted(name: str) -> tuple[str, list[str]]:
    """(task, robots) of the name of a task with other robots: one model for all arms, or one per arm."""
    task, *robots = name.split(MARK)
    return task, robots


def _placed(line: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The entry of an arm with another robot: base moved, rest posture of the new robot."""
    if name == line.get("model", DEFAULT.name):
        return dict(line)
    had, has = robot_named(line.get("model", DEFAULT.name)), robot_named(name)
    nearer_m, yaw_rad = had.reach_m - has.reach_m, np.deg2rad(line["yaw_deg"])
    placed = {key: value for key, value in line.items() if key != "rest_rad"}
    x_m, y_m = line["x_m"] + nearer_m * np.cos(yaw_rad), line["y_m"] + nearer_m * np.sin(yaw_rad)
    return placed | {"model": name, "x_m": round(float(x_m), 6), "y_m": round(float(y_m), 6)}
