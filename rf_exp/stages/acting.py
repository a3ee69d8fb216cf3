"""Who acts in evaluation: the policies that this experiment has trained, or somebody else's."""

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
from rf_exp.sim import Simulator
from rf_exp.stages.cell import Cell
from rf_exp.types import CONTROL_DT_S

Cast = Callable[[Simulator], Sequence[PolicyRunner]]  # who acts in a world; made in the process that asks


@dataclass(frozen=True)
class Acting:
    """What evaluation has to know of those who act. It travels to worker processes."""

    cast: Cast
    limit: int  # control steps of a scene
    plans: Settings | None = None  # with which a coordinator tells policies who is at which subgoal


@dataclass(frozen=True)
class Learning:
    """What stands behind those who act, for their rows."""

    provenance: dict[str, Any]  # as it is recorded beside the rows
    core_s: float = 0.0  # CPU seconds of learning, together
    queries: int = 0  # proposals that the expert was asked for


def acting(cell: Cell) -> Acting:
    """Who acts, for as long as the task says."""
    experiment, limit = cell.experiment, cell.task.step_limit
    if (foreign := experiment.foreign) is not None:
        fastest_rad = experiment.limits.velocity_rad_s * CONTROL_DT_S
        return Acting(partial(foreign_runners, foreign, fastest_rad), foreign.step_limit or limit)
    plans = replace(cell.settings, disturbance_rad=0.0) if cell.arch.coordinated else None
    return Acting(partial(_trained, cell.policy_path, experiment.policy), limit, plans)


def learning(cell: Cell) -> Learning:
    """How they learned. Raises StageError for policies that were made otherwise than the experiment says."""
    if (foreign := cell.experiment.foreign) is not None:
        return Learning({"foreign": foreign.name})
    made = _policies(cell)
    core_s = sum(cost_s(cell.policy_path / view.name) for view in cell.views)
    return Learning(made, core_s, _queries(cell))


@lru_cache(maxsize=1)
def _loaded(folder: Path, config: PolicyConfig) -> tuple[DiffusionRunner, ...]:
    """The policies of a folder, loaded once a process; a finished folder never changes."""
    return load_runners(folder, acting=config)


def _trained(folder: Path, config: PolicyConfig, world: Simulator) -> tuple[DiffusionRunner, ...]:
    return _loaded(folder, config)  # they see what a rollout shows them, whatever the world


def _policies(cell: Cell) -> dict[str, Any]:
    """What the policies were made of: as this experiment says, from which data, with which weights.

    Raises StageError for policies that were made otherwise.
    """
    made, experiment = {}, cell.experiment
    for view in cell.views:
        made[view.name] = provenance(cell.policy_path / view.name)
        config = replace(experiment.training, seed=experiment.train_seed)
        wanted = {"learner": LEARNER, "policy": experiment.policy.identity, "train": config.identity}
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
