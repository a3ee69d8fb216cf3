"""The experiment, read top to bottom like the method section of the paper.

python -m rf_exp.run                                               a quick one, of lift_barrier
python -m rf_exp.run -m task=lift_barrier,place_food arch=all      the architecture table
python -m rf_exp.run stages=[generate] task=all constraints=full   data only
"""

import os
import sys
from collections.abc import Callable
from itertools import product

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from rf_exp.datagen.brain import refuse_keys
from rf_exp.errors import ArgumentError, RfError
from rf_exp.experiment import CONF, read_experiment, register_all_tasks
from rf_exp.stages import evaluate_policies, generate_data, train_policies, write_tables

register_all_tasks()


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
def main(config: DictConfig) -> None:
    """One job: every chosen task under every chosen row of constraints and architecture."""
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore[reportArgumentType]
    stages = set(experiment.stages)

    for task, row in product(experiment.tasks, experiment.rows):
        # RoboBrain proposes, primitives move, RoboChecker checks; what passes becomes the data set.
        if "generate" in stages:
            generate_data(experiment, task, row)
        # One view of the data set for each policy of an architecture, one diffusion policy for each view.
        for arch in experiment.archs:
            if "train" in stages:
                train_policies(experiment, task, row, arch)
            # Every seed counts: consecutive scenes that generation never sees.
            if "evaluate" in stages:
                evaluate_policies(experiment, task, row, arch)

    # All rows there are, beside the paper's figures.
    if "report" in stages:
        write_tables(experiment)


def guarded(job: Callable[[], None]) -> int:
    """Runs `job`; its exit code. 0 done, 1 a stage failed, 2 a wrong argument, 130 interrupted."""
    # Hydra would print every error itself and exit with 1; this lets them through to here.
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    try:
        refuse_keys(sys.argv[1:])  # before Hydra writes them to a file
        job()
    except (ArgumentError, HydraException, OmegaConfBaseException) as error:
        print(f"wrong argument: {error}", file=sys.stderr)
        return 2
    except RfError as error:
        print(f"failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(guarded(main))
