"""Shared simulator: one per process, for all episodes made in it. ManiSkill is imported on first use."""

from typing import TYPE_CHECKING

from rf_exp.tasks import Task
from rf_exp.types import Pictures

if TYPE_CHECKING:
    from rf_exp.sim.simulator import Simulator

# One simulator per process, kept between episodes: building the renderer takes seconds.
_shared: "dict[tuple[str, Pictures], Simulator]" = {}  # by task and pictures


def shared_simulator(task: Task, pictures: Pictures) -> "Simulator":
    """This process's simulator for a task and picture size; closes one of another task or size."""
    from rf_exp.sim.simulator import Simulator  # not above: processes that only start others do not need it

    key = (repr(task), pictures)
    if key not in _shared:
        close_shared_simulator()
        size = {"width_px": pictures.width, "height_px": pictures.height}
        _shared[key] = Simulator(task, **size, render=pictures.render)
    return _shared[key]


def close_shared_simulator() -> None:
    """Closes this process's simulator and frees its memory."""
    while _shared:
        _shared.popitem()[1].close()
