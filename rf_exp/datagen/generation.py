"""Many episodes: consecutive seeds spread over processes, results in the order of the seeds."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain import FaultyBrain
from rf_exp.datagen.episode import EpisodeMaker, Outcome
from rf_exp.datagen.planning import Settings
from rf_exp.findings import Account
from rf_exp.processes import Timeout, in_order
from rf_exp.sim import Limited, depth_and_segmentation, shared_simulator
from rf_exp.types import NO_EXTRAS, Extras, Pictures


def make_episode(
    settings: Settings,
    pictures: Pictures,
    seed: int,
    cameras: Sequence[str] | None = None,
    lead: Iterable[NDArray[np.float64]] = (),
    known: Sequence[Iterable[str]] = (),
    extras: Extras = NO_EXTRAS,
) -> Outcome:
    """One episode in this process, seen by these cameras, or those that `pictures` says.

    `extras` says what else it keeps of what they see; `lead` and `known` as in `EpisodeMaker.make`.
    The same arguments give the same bytes, whatever ran before.
    """
    cameras = pictures.of(len(settings.task.agents)) if cameras is None else cameras
    world = shared_simulator(settings.task, pictures)  # which draws the scene of a seed itself
    take = partial(depth_and_segmentation, world, cameras, extras)
    brain = settings.make_brain(seed)
    made = EpisodeMaker(settings, Limited(world, cameras), brain, extras=take).make(seed, lead, known)
    if made.success and isinstance(brain, FaultyBrain) and not brain.placed:  # it shows nothing of the fault
        ended = f"the fault {brain.fault.name} was not planted: no plan in this scene has a place for it"
        return replace(made, success=False, episode=None, account=Account(ended=ended))
    return made


def generate(
    make: Callable[[int], Outcome], seeds: Sequence[int], workers: int, limit_s: float | None = None
) -> Iterator[Outcome]:
    """Outcomes of `seeds` in their order, each made by `make`, in `workers` processes.

    A seed that takes longer than `limit_s` has failed, and the others go on. The caller may stop
    early; seeds then under way are thrown away. Bytes do not depend on `workers`.
    """
    jobs = (partial(make, seed) for seed in seeds)
    for seed, made in zip(seeds, in_order(jobs, workers, limit_s), strict=False):
        if isinstance(made, Timeout):
            account = Account(ended=str(made))
            yield Outcome(
                seed, False, False, steps=0, attempts=1, contacts=0, wall_s=made.limit_s, account=account
            )
        else:
            yield made
