"""The experiment, read top to bottom like the method section of the paper.

python -m rf_exp.run                                               a quick one, of lift_barrier
python -m rf_exp.run -m task=lift_barrier,place_food arch=all      the architecture table
python -m rf_exp.run stages=[generate] task=all constraints=full   data only
"""

import sys

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from rf_exp.command import composed, guarded, settled
from rf_exp.errors import StageError


@composed("config")
def main(config: DictConfig) -> None:
    """One job: every chosen task under every chosen set of constraints and architecture."""
    # Imported here: --help and a wrong argument are answered without torch and SAPIEN.
    from rf_exp import stages
    from rf_exp.experiment import read_experiment

    given = HydraConfig.get().overrides.task
    experiment = read_experiment(settled(config), given)
    chosen = set(experiment.stages)
    stages.check_cameras(experiment)
    stages.check_folders(experiment)
    stages.say_how_long(experiment)
    demonstrations = 0

    for cell in stages.cells(experiment):
        # RoboBrain proposes, primitives move, RoboChecker checks; what passes becomes the data set.
        if "generate" in chosen:
            demonstrations += stages.generate_data(cell)
        # One view of the data set for each policy of an architecture, one diffusion policy for each view.
        for learned in map(cell.with_arch, experiment.archs):
            if "train" in chosen:
                stages.train_policies(learned)
            # Every seed counts: consecutive scenes that generation never sees.
            if "evaluate" in chosen:
                stages.evaluate_policies(learned)

    # All existing rows, beside the paper's figures.
    if "report" in chosen:
        stages.write_tables(experiment)

    if "generate" in chosen and not demonstrations:
        raise StageError(f"no seed succeeded: {stages.why_seeds_failed(experiment)}")


def command() -> int:
    """Runs the command; its exit code, whatever ends it."""
    return guarded(main)


if __name__ == "__main__":
    sys.exit(command())
