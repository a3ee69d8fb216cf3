"""The gallery: pictures and a film of a successful expert episode of each task.

python -m rf_exp.gallery task=all                     a sheet, a strip and a film per task, and an overview
python -m rf_exp.gallery task=place_food seed=7       one task, from scene seed 7 on

Takes the keys of `python -m rf_exp.run`. Pictures are larger than those of policies and ignore the key
`picture`.
"""

import sys

from omegaconf import DictConfig

from rf_exp import gallery
from rf_exp.command import hydra_command, run_guarded, to_plain_config
from rf_exp.errors import ArgumentError
from rf_exp.experiment import read_experiment


@hydra_command("gallery")
def main(config: DictConfig) -> None:
    """Draws every chosen task, then the overview."""
    experiment = read_experiment(to_plain_config(config))
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

    gallery.write_gallery(experiment, folder)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
