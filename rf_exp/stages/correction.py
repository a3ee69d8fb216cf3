"""DAgger: where policies have failed the expert goes on, and what it does is learned from as well.

The policies of a round act in scenes of their own. Of a rollout that they lose, a moment is drawn in which
somebody was moving; their commands lead there once more, and RoboBrain, planner and RoboChecker take over
(Ross et al. 2011; that the expert carries the episode through, Kelly et al. 2019). What the policies did is
stored too, marked as nobody's subgoal, and not learned from. How many proposals the expert was asked for is
in the rows.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.artifacts import keep_text
from rf_exp.datagen import Outcome, make_episode
from rf_exp.errors import StageError
from rf_exp.experiment import CORRECTION_SEED, CORRECTION_SEEDS
from rf_exp.findings import Account
from rf_exp.policy import sent_on
from rf_exp.stages.acting import acting, learned
from rf_exp.stages.artifacts import continued, owned
from rf_exp.stages.cell import Cell
from rf_exp.stages.evaluation import scene_of
from rf_exp.stages.generation import attempts, collect
from rf_exp.stages.logs import rate_log
from rf_exp.store import Store, card
from rf_exp.tasks import Task
from rf_exp.types import CORRECTION, Rollout, RolloutStep

MOMENTS = 3  # at which the expert is asked, each half as late as the one before, until it succeeds


def demonstrations(cell: Cell) -> tuple[Path, int]:
    """The data set, and of how many of its episodes policies learn, once it is known to hold enough."""
    if cell.experiment.dagger.rounds:
        return cell.corrected_path, len(Store.open(cell.corrected_path))
    path, wanted = cell.data_path, cell.experiment.demos
    if not path.exists():
        raise StageError(f"no data at {path}; run stages=[generate] first")
    found = len(Store.open(path))
    if found < wanted:
        raise StageError(
            f"{path} has {found} demonstrations, demos={wanted} were asked for; "
            "run stages=[generate] with that number first"
        )
    return path, wanted


def correct(cell: Cell) -> None:
    """The data set of a round of correction: that of the round before, and the expert's corrections.

    Continues where it stopped. Raises StageError where the policies of the round before were made otherwise.
    """
    experiment, rounds = cell.experiment, cell.experiment.dagger.rounds
    before = replace(cell, experiment=replace(experiment.after(rounds - 1), shield=False))
    policies = acting(before)
    provenance = cell.correction_identity(policies.step_limit, learned(before).provenance)
    data, demos = demonstrations(before)
    source = Store.open(data).first(demos)
    path, rows_path = cell.corrected_path, cell.correction_path
    with (
        owned(rows_path, provenance, [path]),
        owned(path),
        _continued(cell.task, path, source, provenance) as store,
    ):
        expert = partial(
            make_episode,
            cell.settings,
            experiment.pictures,
            cameras=store.cameras,
            known=_usual(source),
            extras=store.extras,
        )
        act = scene_of(before, policies)
        first = CORRECTION_SEED + CORRECTION_SEEDS * (rounds - 1)

        collect(
            cell.title("correct"),
            store,
            rows_path,
            range(first, first + experiment.dagger.rollouts),
            None,
            partial(attempts, cell, partial(_corrected, act, expert)),
            partial(rate_log, cell, "correct"),
            became="corrected",
        )
        keep_text(path.with_suffix(".md"), card(store))


@contextmanager
def _continued(task: Task, path: Path, source: Store, provenance: dict[str, Any]) -> Iterator[Store]:
    """A store for writing that begins with all episodes of another; what is there already stays."""
    with continued(path, provenance, source, task, source.description) as store:
        for index in range(len(store), len(source)):
            store.append(source.episode(index))
        yield store


def _usual(store: Store) -> tuple[tuple[str, ...], ...]:
    """The texts of the subgoals of each agent that most episodes have."""
    counted = Counter(tuple(map(tuple, certificate["subgoals"])) for certificate in store.certificates)
    return counted.most_common(1)[0][0]


def _corrected(
    act: Callable[..., tuple[Rollout, float]], expert: Callable[..., Outcome], seed: int
) -> Outcome:
    """A rollout in this process and, if it is lost, what the expert makes of it."""
    steps: list[RolloutStep] = []
    rolled, wall_s = act(seed, watch=steps.append)
    if rolled.success:
        nothing = Account(ended="nothing to correct: success")
        return Outcome(seed, False, rolled.success_paper, 0, 0, 0, wall_s, nothing)
    commands = np.stack([step.action for step in steps])
    qpos = np.stack([step.scene.qpos for step in steps])
    moved = np.flatnonzero(np.any(sent_on(qpos, commands)[1:], axis=1)) + 1
    moment = int(np.random.default_rng([seed, CORRECTION]).choice(moved)) if len(moved) else 0
    asked = 0
    for again in range(MOMENTS):
        outcome = expert(seed, lead=commands[: moment >> again])
        asked += outcome.attempts
        if outcome.success:
            break
    return replace(outcome, attempts=asked, wall_s=wall_s + outcome.wall_s)
