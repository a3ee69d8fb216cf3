"""The experiment, read top to bottom like the method section of the paper.

python -m rf_exp.run                                               a quick one, of lift_barrier
python -m rf_exp.run -m task=lift_barrier,place_food arch=all      the architecture table
python -m rf_exp.run stages=[generate] task=all constraints=full   data only
"""

import sys

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from rf_exp.command import hydra_command, run_guarded, to_plain_config
from rf_exp.errors import StageError


@hydra_command("config")
def main(config: DictConfig) -> None:
    """One job: every chosen task under every chosen set of constraints and architecture."""
    # Imported here: --help and a wrong argument are answered without torch and SAPIEN.
    from rf_exp import stages
    from rf_exp.experiment import read_experiment

    overrides = HydraConfig.get().overrides.task
    experiment = read_experiment(to_plain_config(config), overrides)
    selected = set(experiment.stages)
    stages.check_cameras(experiment)
    stages.check_folders(experiment)
    stages.print_estimate(experiment)
    demonstrations = 0

    for cell in stages.cells(experiment):
        # RoboBrain proposes, primitives move, RoboChecker checks; what passes becomes the data set.
        if "generate" in selected:
            demonstrations += stages.generate_data(cell)
        # One view of the data set for each policy of an architecture, one diffusion policy for each view.
        for policy_cell in map(cell.with_arch, experiment.archs):
            if "train" in selected:
                stages.train_policies(policy_cell)
            # Every seed counts: consecutive scenes that generation never sees.
            if "evaluate" in selected:
                stages.evaluate_policies(policy_cell)

    # All existing rows, beside the paper's figures.
    if "report" in selected:
        stages.write_tables(experiment)

    if "generate" in selected and not demonstrations:
        raise StageError(f"no seed succeeded: {stages.why_seeds_failed(experiment)}")


def command() -> int:
    """Runs the command; its exit code, whatever ends it."""
    return run_guarded(main)


if __name__ == "__main__":
    sys.exit(command())
