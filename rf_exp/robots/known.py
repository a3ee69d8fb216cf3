"""The robots that tasks may name, by the values of their `model`."""

from rf_exp.errors import ArgumentError, choices
from rf_exp.robots.panda import PANDA
from rf_exp.robots.robot import Robot

DEFAULT = PANDA  # of a task that names none, and of data from before they said
_KNOWN = {DEFAULT.name: DEFAULT}


def add_robot(robot: Robot) -> None:
    """Lets tasks name a robot. Raises ArgumentError for the name of another one."""
    known = _KNOWN.setdefault(robot.name, robot)
    if known != robot:
        raise ArgumentError(f"there is another robot called {robot.name!r}; call it otherwise")


def robot_named(name: str) -> Robot:
    """Raises ArgumentError for a name that nobody has added."""
    if name not in _KNOWN:
        raise choices("robot model", name, _KNOWN)
    return _KNOWN[name]


def known_robots() -> tuple[Robot, ...]:
    """All of them, in the order in which they were added."""
    return tuple(_KNOWN.values())
