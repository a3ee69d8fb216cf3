"""Checks the laws of the suite on tasks: prints one line per law, that it holds or where it is broken.

python -m rf_exp.laws task=lift_barrier
python -m rf_exp.laws task=ring arms=6
python -m rf_exp.laws "hydra.searchpath=[file://$PWD/tests/tutorial/conf]" task=push_button

Takes the keys of `python -m rf_exp.run`. With render=false the laws about pictures are left out. A broken
law ends the command with code 1.
"""

import sys

from omegaconf import DictConfig

from rf_exp import laws
from rf_exp.command import hydra_command, run_guarded, to_plain_config
from rf_exp.errors import StageError
from rf_exp.experiment import read_experiment
from rf_exp.progress import console


@hydra_command("laws")
def main(config: DictConfig) -> None:
    """Checks every chosen task, one law after the other."""
    experiment = read_experiment(to_plain_config(config))
    violated = 0
    for task in experiment.tasks:
        for law, violations in laws.check_task(task, pictures=experiment.pictures.render):
            violated += bool(violations)
            verdict = "; ".join(violations) or "holds"
            console.print(f"{task.name}: {law.sentence}: {verdict}")
    if violated:
        raise StageError(f"{violated} laws are broken; where is said above")


if __name__ == "__main__":
    sys.exit(run_guarded(main))
