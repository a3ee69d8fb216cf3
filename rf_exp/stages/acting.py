"""Policies that act in evaluation: those that this experiment has trained, or somebody else's."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from rf_exp.ablation import GenerationRow, read_rows
from rf_exp.datagen import Settings
from rf_exp.policy import (
    LEARNER,
    DiffusionRunner,
    PolicyConfig,
    PolicyRunner,
    cost_s,
    expect_policy,
    foreign_runners,
    load_runners,
    provenance,
)
from rf_exp.stages.cell import Cell
from rf_exp.types import CONTROL_DT_S


@dataclass(frozen=True)
class Policies:
    """Policies as evaluation needs them. The value travels to worker processes, where runners are made."""

    make_runners: Callable[[], Sequence[PolicyRunner]]  # made in the process that asks
    step_limit: int  # of a scene
    coordinator: Settings | None = None  # of the plans by which one coordinates the policies, if one does


@dataclass(frozen=True)
class Learned:
    """How policies have learned, for their rows."""

    provenance: dict[str, Any]  # as it is recorded beside the rows
    core_s: float = 0.0  # CPU seconds of learning, together
    queries: int = 0  # proposals that the expert was asked for


def acting(cell: Cell) -> Policies:
    """The policies of a cell, which act for as long as the task says."""
    experiment, limit = cell.experiment, cell.task.step_limit
    if (foreign := experiment.foreign) is not None:
        fastest_rad = experiment.limits.velocity_rad_s * CONTROL_DT_S
        runners = partial(foreign_runners, foreign, fastest_rad, cell.task)
        return Policies(runners, foreign.step_limit or limit)
    coordinator = replace(cell.settings, disturbance_rad=0.0) if cell.arch.coordinated else None
    return Policies(partial(_loaded, cell.policy_path, experiment.policy), limit, coordinator)


def learned(cell: Cell) -> Learned:
    """How they learned. Raises StageError for policies that were made otherwise than the experiment says."""
    if (foreign := cell.experiment.foreign) is not None:
        return Learned({"foreign": foreign.name})
    made = _provenance(cell)  # first: it says whether there are any
    core_s = sum(cost_s(cell.policy_path / view.name) for view in cell.views)
    return Learned(made, core_s, _queries(cell))


@lru_cache(maxsize=1)
def _loaded(folder: Path, config: PolicyConfig) -> tuple[DiffusionRunner, ...]:
    """The policies of a folder, loaded once a process; a finished folder never changes."""
    return load_runners(folder, acting=config)


def _provenance(cell: Cell) -> dict[str, Any]:
    """What the policies were made of: as this experiment says, from which data, with which weights.

    Raises StageError for policies that were made otherwise.
    """
    made, experiment = {}, cell.experiment
    for view in cell.views:
        made[view.name] = provenance(cell.policy_path / view.name)
        config = replace(experiment.training, seed=experiment.train_seed)
        wanted = {"learner": LEARNER, "policy": experiment.policy.learned, "train": config.identity}
        expect_policy(cell.policy_path / view.name, wanted)
    weights = {name: one.pop("weights") for name, one in made.items()}
    return {"data": next(iter(made.values()))["data"], "weights": weights}


def _queries(cell: Cell) -> int:
    """How many proposals the expert was asked for to correct the policies, in all rounds."""
    count = 0
    for rounds in range(1, cell.experiment.dagger.rounds + 1):
        path = cell.after(rounds).correction_path
        count += sum(made.attempts for made in read_rows(path, GenerationRow))
    return count
