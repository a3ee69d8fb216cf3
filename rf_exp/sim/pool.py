"""Simulators in many processes: one in each, kept between episodes, results in order."""

import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from joblib import Parallel

from rf_exp.sim.simulator import Simulator
from rf_exp.tasks import Task
from rf_exp.types import Pictures

# One simulator a process, kept between episodes: building the renderer costs seconds.
_simulator: tuple[tuple[str, Pictures], Simulator] | None = None


def simulator(task: Task, pictures: Pictures) -> Simulator:
    """This process's simulator for a task and picture size; an earlier one is closed."""
    global _simulator
    key = (repr(task), pictures)
    if _simulator is None or _simulator[0] != key:
        close_simulator()
        size = {"width_px": pictures.width, "height_px": pictures.height}
        _simulator = key, Simulator(task, **size, render=pictures.render)
    return _simulator[1]


def close_simulator() -> None:
    """Gives the memory of this process's simulator back."""
    global _simulator
    if _simulator is not None:
        _simulator[1].close()
        _simulator = None


def in_order(
    jobs: Iterable[tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]], workers: int
) -> Iterator[Any]:
    """Results of joblib's delayed calls, in order, by `workers` processes; 1 stays in this one.

    A caller that stops early drops the calls under way.
    """
    if workers == 1:
        yield from (function(*positional, **named) for function, positional, named in jobs)
        return
    # Each process draws on one core; without this every one starts a thread for each core.
    threads = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
    before = {name: os.environ.get(name) for name in threads}
    os.environ.update({name: value for name, value in threads.items() if before[name] is None})
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "[0-9]+ tasks which were still being processed")
            yield from Parallel(n_jobs=workers, return_as="generator", pre_dispatch="2*n_jobs")(jobs)
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
