"""Shared simulator: the one of a process, for whoever makes episodes in it. ManiSkill is imported with it."""

from typing import TYPE_CHECKING

from rf_exp.tasks import Task
from rf_exp.types import Pictures

if TYPE_CHECKING:
    from rf_exp.sim.simulator import Simulator

# One simulator a process, kept between episodes: building the renderer costs seconds.
_shared: "dict[tuple[str, Pictures], Simulator]" = {}  # by task and pictures


def shared_simulator(task: Task, pictures: Pictures) -> "Simulator":
    """This process's simulator for a task and picture size; an earlier one is closed."""
    from rf_exp.sim.simulator import Simulator  # not by those who only start processes that simulate

    key = (repr(task), pictures)
    if key not in _shared:
        close_shared_simulator()
        size = {"width_px": pictures.width, "height_px": pictures.height}
        _shared[key] = Simulator(task, **size, render=pictures.render)
    return _shared[key]


def close_shared_simulator() -> None:
    """Gives the memory of this process's simulator back."""
    while _shared:
        _shared.popitem()[1].close()
