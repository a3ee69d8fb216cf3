"""Many episodes: consecutive seeds spread over processes, results in the order of the seeds."""

from collections.abc import Iterator, Sequence
from functools import partial

from rf_exp.datagen.episode import EpisodeMaker, Outcome
from rf_exp.datagen.planning import Settings
from rf_exp.processes import Overdue, in_order
from rf_exp.sim.pool import simulator
from rf_exp.sim.simulator import Limited
from rf_exp.types import Pictures


def make_episode(settings: Settings, pictures: Pictures, seed: int) -> Outcome:
    """One episode in this process. The same arguments give the same bytes, whatever ran before."""
    world = Limited(simulator(settings.task, pictures), pictures.of(len(settings.task.agents)))
    return EpisodeMaker(settings, world, settings.make_brain(seed)).make(seed)


def generate(
    settings: Settings,
    pictures: Pictures,
    seeds: Sequence[int],
    workers: int,
    limit_s: float | None = None,
) -> Iterator[Outcome]:
    """Outcomes of `seeds` in their order, made by `workers` processes.

    A seed that takes longer than `limit_s` has failed, and the others go on. The caller may stop
    early; seeds then under way are thrown away. Bytes do not depend on `workers`.
    """
    jobs = (partial(make_episode, settings, pictures, seed) for seed in seeds)
    for seed, made in zip(seeds, in_order(jobs, workers, limit_s), strict=False):
        yield failed(seed, made) if isinstance(made, Overdue) else made


def failed(seed: int, overdue: Overdue) -> Outcome:
    """A seed that took too long."""
    return Outcome(
        seed,
        success=False,
        success_paper=False,
        steps=0,
        attempts=1,
        violations=0,
        contacts=0,
        reason=str(overdue),
        wall_s=overdue.limit_s,
    )
