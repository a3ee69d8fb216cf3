"""The experiment, read top to bottom like the method section of the paper.

python -m rf_exp.run                                               a quick one, of lift_barrier
python -m rf_exp.run -m task=lift_barrier,place_food arch=all      the architecture table
python -m rf_exp.run stages=[generate] task=all constraints=full   data only
"""

import sys
from itertools import product

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from rf_exp.command import CONF, explained, guarded, register_all_tasks, settled
from rf_exp.errors import StageError

register_all_tasks()


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
@explained
def main(config: DictConfig) -> None:
    """One job: every chosen task under every chosen set of constraints and architecture."""
    # Imported where they are needed: help and a wrong argument are answered without torch and SAPIEN.
    from rf_exp.experiment import read_experiment

    given = HydraConfig.get().overrides.task
    experiment = read_experiment(settled(config), given)
    from rf_exp.stages import (
        check_folders,
        evaluate_policies,
        generate_data,
        say_how_long,
        train_policies,
        write_tables,
    )

    stages = set(experiment.stages)
    check_folders(experiment)
    say_how_long(experiment)
    demonstrations = 0

    for task, constraint_set in product(experiment.tasks, experiment.constraint_sets):
        # RoboBrain proposes, primitives move, RoboChecker checks; what passes becomes the data set.
        if "generate" in stages:
            demonstrations += generate_data(experiment, task, constraint_set)
        # One view of the data set for each policy of an architecture, one diffusion policy for each view.
        for arch in experiment.archs:
            if "train" in stages:
                train_policies(experiment, task, constraint_set, arch)
            # Every seed counts: consecutive scenes that generation never sees.
            if "evaluate" in stages:
                evaluate_policies(experiment, task, constraint_set, arch)

    # All rows there are, beside the paper's figures.
    if "report" in stages:
        write_tables(experiment)

    if "generate" in stages and not demonstrations:
        raise StageError(f"no seed succeeded; the reasons are in {experiment.out / 'results' / 'generate'}")


def command() -> int:
    """The console script `rf-exp`; its exit code."""
    return guarded(main)


if __name__ == "__main__":
    sys.exit(command())
