"""Writes a page about one episode, with its recording (paper, figure of RoboChecker at work).

python -m rf_exp.demonstration                       Take Photo
python -m rf_exp.demonstration task=lift_barrier     any other task
"""

import sys

from omegaconf import DictConfig

from rf_exp import demonstration, sim
from rf_exp.command import hydra_command, run_guarded, to_plain_config
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import read_experiment
from rf_exp.progress import console

SEEDS = 20  # tried until one succeeds


@hydra_command("demonstration")
def main(config: DictConfig) -> None:
    """Writes a page for every chosen task, about the first seed that succeeds."""
    experiment = read_experiment(to_plain_config(config))
    if len(experiment.constraint_sets) != 1:
        names = ", ".join(row.name for row in experiment.constraint_sets)
        raise ArgumentError(
            f"a demonstration is of one row of constraints, got {names}; use constraints=full"
        )
    for task in experiment.tasks:
        settings = experiment.settings(task, experiment.constraint_sets[0])
        folder, last = experiment.out / "demonstrations", experiment.seed + SEEDS - 1
        for seed in range(experiment.seed, last + 1):
            outcome = demonstration.demonstrate(settings, experiment.pictures, seed, folder)
            if outcome.success:
                break
            console.print(f"{task.name}, seed {seed}: {outcome.reason}")
        else:
            raise StageError(f"{task.name}: no success in seeds {experiment.seed} to {last}")
    sim.close_shared_simulator()


if __name__ == "__main__":
    sys.exit(run_guarded(main))
