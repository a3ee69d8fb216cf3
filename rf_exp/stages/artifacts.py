"""Who may make an artifact, whether it can be written, and whether one that is there was made alike."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from rf_exp.artifacts import configuration_file, expect_same, locked, read_json, sweep, write_json
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import Experiment
from rf_exp.stages.cell import cells
from rf_exp.store import Description, Store
from rf_exp.tasks import Task


def continued(
    path: Path, identity: Mapping[str, Any], source: Store, task: Task, description: Description | None
) -> Store:
    """A store for writing with the arrays of another, of the same task: the one that is there, or a new one.

    Raises StageError where it was made of another configuration than `identity`.
    """
    if path.exists():
        return Store.open(path, identity, writable=True)
    of = source.attrs
    size = of["agents"], of["cameras"], of["height"], of["width"], of["objects"], source.disturbed
    return Store.create(path, identity, *size, description, [each.model for each in task.robots])


@contextmanager
def owned(
    artifact: Path, configuration: Mapping[str, Any] | None = None, also: Sequence[Path] = ()
) -> Iterator[None]:
    """Holds the right to make an artifact; other jobs that want it wait here, and say for whom.

    What a kill left half-written beside it is removed. With `configuration`, the artifact must be
    made of that (`same_configuration`; `also` is made together with it). Raises StageError naming
    what differs, ArgumentError where nothing can be written.
    """
    with ExitStack() as stack:
        try:
            artifact.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(artifact.with_name(f".{artifact.name}.lock"), str(artifact)))
        except OSError as error:
            raise ArgumentError(
                f"cannot write below {artifact.parent}: {error.strerror}; "
                "choose another folder with out=FOLDER"
            ) from error
        sweep(artifact.parent)
        if configuration is not None:
            same_configuration(artifact, configuration, artifact.exists(), also)
        yield


def same_configuration(
    artifact: Path, configuration: Mapping[str, Any], made: bool, also: Sequence[Path] = ()
) -> None:
    """Records beside an artifact that is not `made` yet what it will be made of; compares one that is.

    Raises StageError naming what differs and all that has to go before it can be made anew.
    """
    record = configuration_file(artifact)
    if not made:
        write_json(record, configuration)
        return
    listed = ", ".join(map(str, [artifact, record, *(path for path in also if path.exists())]))
    remedy = f"delete {listed}, or choose another folder with out=FOLDER"
    if not record.exists():
        raise StageError(f"{artifact} is there, and {record} that says what it was made of is not; {remedy}")
    expect_same(artifact, read_json(record, remedy), configuration, remedy)


def check_folders(experiment: Experiment) -> None:
    """Makes the folders of the chosen stages before any work, so that none of it is lost.

    Raises ArgumentError naming one that cannot be used.
    """
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


def check_cameras(experiment: Experiment) -> None:
    """Raises ArgumentError where policies would look through a camera that makes no pictures."""
    if not {"generate", "train"} <= set(experiment.stages) or not experiment.policy.encoder.pictures:
        return
    for cell in cells(experiment):
        there = experiment.pictures.of(len(cell.task.agents))
        for learned in map(cell.with_arch, experiment.archs):
            streams = (stream for view in learned.views for stream in view.streams)
            missing = {camera for stream in streams for camera in stream.cameras} - {*there}
            if missing and not cell.data_path.exists():  # demonstrations that are there may have more
                raise ArgumentError(
                    f"arch={learned.arch.name} looks through {', '.join(sorted(missing))}, and cameras="
                    f"{experiment.pictures.cameras} makes no pictures of it; use cameras=all"
                )


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
