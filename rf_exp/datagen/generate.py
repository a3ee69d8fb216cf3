"""Many episodes: consecutive seeds spread over processes, results in the order of the seeds."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from joblib import Parallel, delayed

from rf_exp.datagen.brain import make_brain
from rf_exp.datagen.episode import EpisodeMaker, Outcome, Settings
from rf_exp.sim import Simulator


@dataclass(frozen=True)
class Pictures:
    """What the cameras take: size in pixels, or nothing at all."""

    width: int = 320
    height: int = 240
    render: bool = True


# One simulator a process, kept between seeds: building the renderer costs seconds.
_simulator: tuple[tuple[object, ...], Simulator] | None = None


def make_episode(settings: Settings, pictures: Pictures, seed: int) -> Outcome:
    """One episode in this process. The same arguments give the same bytes, whatever ran before."""
    return EpisodeMaker(settings, simulator(settings, pictures), make_brain(settings.brain)).make(seed)


def simulator(settings: Settings, pictures: Pictures) -> Simulator:
    """This process's simulator for a task and picture size."""
    global _simulator
    key = (repr(settings.task), pictures)
    if _simulator is None or _simulator[0] != key:
        close_simulator()
        made = Simulator(
            settings.task, width_px=pictures.width, height_px=pictures.height, render=pictures.render
        )
        _simulator = (key, made)
    return _simulator[1]


def close_simulator() -> None:
    """Gives the renderer's memory back."""
    global _simulator
    if _simulator is not None:
        _simulator[1].close()
        _simulator = None


def generate(settings: Settings, pictures: Pictures, seeds: Sequence[int], workers: int) -> Iterator[Outcome]:
    """Outcomes of `seeds` in their order, made by `workers` processes.

    The caller may stop early; seeds then under way are thrown away. Bytes do not depend on `workers`.
    """
    if workers == 1:
        yield from (make_episode(settings, pictures, seed) for seed in seeds)
        return
    # Each process draws on one core; without this every one starts a thread for each core.
    threads = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
    missing = {name: value for name, value in threads.items() if name not in os.environ}
    os.environ.update(missing)
    try:
        jobs = (delayed(make_episode)(settings, pictures, seed) for seed in seeds)
        yield from Parallel(n_jobs=workers, return_as="generator", pre_dispatch="2*n_jobs")(jobs)
    finally:
        for name in missing:
            del os.environ[name]
