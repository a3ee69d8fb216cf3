"""DAgger: where policies have failed the expert goes on, and what it does is learned from as well.

The policies of a round act in scenes of their own. Of a rollout that they lose, a moment is drawn in which
somebody was moving; their commands lead there once more, and RoboBrain, planner and RoboChecker take over
(Ross et al. 2011; that the expert carries the episode through, Kelly et al. 2019). What the policies did is
stored too, marked as nobody's subgoal, and not learned from. How many proposals the expert was asked for is
in the rows.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.ablation.rows import GenerationRow
from rf_exp.artifacts.identity import plain
from rf_exp.datagen.episode import EpisodeMaker, Outcome
from rf_exp.datagen.generate import failed
from rf_exp.datagen.planning import Settings
from rf_exp.errors import StageError
from rf_exp.experiment import CORRECTION_SEED, CORRECTION_SEEDS, Experiment
from rf_exp.policy.coordination import STILL_RAD
from rf_exp.processes import Overdue, in_order
from rf_exp.sim.pool import simulator
from rf_exp.sim.simulator import Limited
from rf_exp.stages.artifacts import corrected_path, correction_path, data_path, owned, policy_path
from rf_exp.stages.evaluation import scene_of, step_limit, trained
from rf_exp.stages.generation import collect, generation_row
from rf_exp.stages.identity import generation_identity
from rf_exp.stages.logs import rate_log
from rf_exp.store import Store
from rf_exp.tasks import Task
from rf_exp.types import ARM_JOINTS, Arch, Pictures, Rollout, RolloutStep, Row

MOMENTS = 3  # at which the expert is asked, each half as late as the one before, until it succeeds
STREAM = 3  # of the random numbers of an episode


@dataclass(frozen=True)
class Expert:
    """How demonstrations are made, and what their subgoals are called."""

    settings: Settings
    pictures: Pictures
    cameras: tuple[str, ...]
    texts: tuple[tuple[str, ...], ...]  # of the subgoals of each agent, in the order of their numbers

    def goes_on(self, seed: int, lead: NDArray[np.float64]) -> Outcome:
        """From where commands (T, N, 8) lead in the scene of `seed`."""
        world = Limited(simulator(self.settings.task, self.pictures), self.cameras)
        return EpisodeMaker(self.settings, world, self.settings.make_brain(seed)).make(seed, lead, self.texts)


def demonstrations(experiment: Experiment, task: Task, row: Row, arch: Arch) -> tuple[Path, int]:
    """The data set, and of how many of its episodes policies learn, once it is known to hold enough."""
    if experiment.dagger.rounds:
        path = corrected_path(experiment, task, row, arch)
        return path, len(Store.open(path))
    path = data_path(experiment, task, row)
    if not path.exists():
        raise StageError(f"no data at {path}; run stages=[generate] first")
    found = len(Store.open(path))
    if found < experiment.demos:
        raise StageError(
            f"{path} has {found} demonstrations, demos={experiment.demos} were asked for; "
            "run stages=[generate] with that number first"
        )
    return path, experiment.demos


def correct(experiment: Experiment, task: Task, row: Row, arch: Arch) -> None:
    """The data set of a round of correction: that of the round before, and the expert's corrections.

    Continues where it stopped. Raises StageError where the policies of the round before were made otherwise.
    """
    rounds = experiment.dagger.rounds
    before = replace(experiment.after(rounds - 1), shield=False)
    limit = step_limit(experiment, task, row)
    made_of = {
        **generation_identity(experiment, task, row),
        "demos": experiment.demos,
        "rollouts": experiment.dagger.rollouts,
        "step_limit": limit,
        "policies": plain(trained(before, task, arch, policy_path(before, task, row, arch))),
        "acting": plain(experiment.policy.identity),
    }
    data, demos = demonstrations(before, task, row, arch)
    source = Store.open(data).first(demos)
    path = corrected_path(experiment, task, row, arch)
    rows_path = correction_path(experiment, task, row, arch)
    with (
        owned(rows_path, made_of, [path]),
        owned(path),
        _continued(path, source, made_of) as store,
    ):
        expert = Expert(experiment.settings(task, row), experiment.pictures, store.cameras, _usual(source))
        act = scene_of(before, task, row, arch, limit)
        first = CORRECTION_SEED + CORRECTION_SEEDS * (rounds - 1)

        def make(seeds: Sequence[int]) -> Iterator[Outcome]:
            jobs = (partial(_corrected, act, expert, seed) for seed in seeds)
            results = in_order(jobs, experiment.workers, experiment.seed_limit_s)
            for seed, made in zip(seeds, results, strict=False):
                yield failed(seed, made) if isinstance(made, Overdue) else made

        def tell(outcome: Outcome) -> GenerationRow:
            return generation_row(task, row, experiment.brain.name, outcome, experiment.disturbance_rad)

        collect(
            f"correct {task.name}/{row.name}/{arch.name}{experiment.corrected}",
            store,
            rows_path,
            range(first, first + experiment.dagger.rollouts),
            None,
            make,
            tell,
            partial(rate_log, experiment, "correct", task, row, arch),
            became="corrected",
        )


@contextmanager
def _continued(path: Path, source: Store, made_of: dict[str, Any]) -> Iterator[Store]:
    """A store for writing that begins with all episodes of another; what is there already stays."""
    if path.exists():
        store = Store.open(path, made_of, writable=True)
    else:
        of = source.attrs
        size = of["agents"], of["cameras"], of["height"], of["width"], of["objects"], source.disturbed
        store = Store.create(path, made_of, *size)
    with store:
        for index in range(len(store), len(source)):
            store.append(source.episode(index))
        yield store


def _usual(store: Store) -> tuple[tuple[str, ...], ...]:
    """The texts of the subgoals of each agent that most episodes have."""
    counted = Counter(tuple(map(tuple, certificate["subgoals"])) for certificate in store.certificates)
    return counted.most_common(1)[0][0]


def _corrected(act: Callable[..., tuple[Rollout, float]], expert: Expert, seed: int) -> Outcome:
    """A rollout in this process and, if it is lost, what the expert makes of it."""
    steps: list[RolloutStep] = []
    rolled, wall_s = act(seed, watch=steps.append)
    nothing = Outcome(seed, False, rolled.success_paper, 0, 0, 0, 0, "nothing to correct: success", wall_s)
    if rolled.success:
        return nothing
    commands = np.stack([step.action for step in steps])
    joints = np.abs(np.diff(commands[..., :ARM_JOINTS], axis=0)).max(axis=(1, 2))
    moved = np.flatnonzero(joints > STILL_RAD) + 1
    if not len(moved):
        moved = np.zeros(1, int)
    moment = int(np.random.default_rng([seed, STREAM]).choice(moved))
    asked = 0
    for again in range(MOMENTS):
        outcome = expert.goes_on(seed, commands[: moment >> again])
        asked += outcome.attempts
        if outcome.success:
            break
    return replace(outcome, attempts=asked, wall_s=wall_s + outcome.wall_s)
