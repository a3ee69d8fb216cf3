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
from rf_exp.command import composed, guarded, settled
from rf_exp.errors import StageError
from rf_exp.experiment import read_experiment
from rf_exp.progress import console


@composed("laws")
def main(config: DictConfig) -> None:
    """Checks every chosen task, one law after the other."""
    experiment = read_experiment(settled(config))
    broken = 0
    for task in experiment.tasks:
        for law, found in laws.judged(task, pictures=experiment.pictures.render):
            broken += bool(found)
            console.print(f"{task.name}: {law.says}: {'holds' if not found else '; '.join(found)}")
    if broken:
        raise StageError(f"{broken} laws are broken; where is said above")


if __name__ == "__main__":
    sys.exit(guarded(main))
