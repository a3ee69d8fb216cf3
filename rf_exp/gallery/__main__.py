"""The gallery: what each task looks like when it is done well.

python -m rf_exp.gallery task=all                     two sheets and a film of every task, and a sheet of all
python -m rf_exp.gallery task=place_food seed=7       of one, from scene seed 7 on

Takes the keys of `python -m rf_exp.run`. Pictures are larger than those that policies see, whatever
`picture` says.
"""

import sys

from omegaconf import DictConfig

from rf_exp import gallery
from rf_exp.command import composed, guarded, settled
from rf_exp.errors import ArgumentError
from rf_exp.experiment import read_experiment


@composed("gallery")
def main(config: DictConfig) -> None:
    """One job: every chosen task, then all of them on one sheet."""
    experiment = read_experiment(settled(config))
    if not experiment.pictures.render:
        raise ArgumentError("render=false makes no pictures, and the gallery is pictures; leave it out")
    if len(experiment.constraint_sets) > 1:
        chosen = ", ".join(row.name for row in experiment.constraint_sets)
        raise ArgumentError(f"constraints are {chosen}; the gallery shows one of them, e.g. constraints=full")
    folder = experiment.out / "gallery"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"cannot write below {experiment.out}: {error.strerror}") from error

    gallery.show(experiment, folder)


if __name__ == "__main__":
    sys.exit(guarded(main))
