"""Whether all that an experiment will write can be written: asked before any work, so that none is lost."""

from pathlib import Path
from tempfile import TemporaryFile

from rf_exp.errors import ArgumentError
from rf_exp.experiment import Experiment
from rf_exp.stages.cell import cells


def check_folders(experiment: Experiment) -> None:
    """Makes the folders of the chosen stages. Raises ArgumentError naming one that cannot be used."""
    for folder in sorted(_folders(experiment)):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise ArgumentError(
                f"cannot write below {folder}: {error.strerror}; make way for that folder, choose "
                f"another one with out=FOLDER{', or use wandb=disabled' if folder.name == 'wandb' else ''}"
            ) from error


def _folders(experiment: Experiment) -> set[Path]:
    stages, found = set(experiment.stages), {experiment.out}
    for cell in cells(experiment):
        if "generate" in stages:
            found |= {cell.data_path.parent, cell.generation_path.parent}
        looks = {"generate": experiment.recordings, "evaluate": experiment.recordings or experiment.films}
        if any(looks.get(stage) for stage in stages):
            found.add(cell.recording_path("generate", 0).parent)
        for learned in map(cell.with_arch, experiment.archs):
            if "train" in stages:
                found.add(learned.policy_path)
            if "evaluate" in stages:
                found.add(learned.evaluation_path.parent)
    if stages & {"generate", "train", "evaluate"} and experiment.wandb != "disabled":
        found.add(experiment.out / "wandb")
    if "report" in stages:
        found.add(experiment.out / "tables")
    return found
