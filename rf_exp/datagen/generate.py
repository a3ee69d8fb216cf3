"""Many episodes: consecutive seeds spread over processes, results in the order of the seeds."""

from collections.abc import Iterator, Sequence

from joblib import delayed

from rf_exp.datagen.episode import EpisodeMaker, Outcome, Settings
from rf_exp.sim.pool import in_order, simulator
from rf_exp.types import Pictures


def make_episode(settings: Settings, pictures: Pictures, seed: int) -> Outcome:
    """One episode in this process. The same arguments give the same bytes, whatever ran before."""
    return EpisodeMaker(settings, simulator(settings.task, pictures), settings.make_brain(seed)).make(seed)


def generate(settings: Settings, pictures: Pictures, seeds: Sequence[int], workers: int) -> Iterator[Outcome]:
    """Outcomes of `seeds` in their order, made by `workers` processes.

    The caller may stop early; seeds then under way are thrown away. Bytes do not depend on `workers`.
    """
    return in_order((delayed(make_episode)(settings, pictures, seed) for seed in seeds), workers)
