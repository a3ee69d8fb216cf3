"""Where artifacts are, who may make them, and whether they fit the configuration.

The layout below `out` is a contract that other people's scripts rely on.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rf_exp.ablation import rows_file
from rf_exp.artifacts import configuration_file, expect_same, locked, read_json, sweep, write_json
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import Experiment
from rf_exp.tasks import Task
from rf_exp.types import Arch, ConstraintSet


def data_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet) -> Path:
    return experiment.out / "data" / task.name / constraint_set.name / f"{experiment.name}.zarr"


def generation_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet) -> Path:
    name = constraint_set.name
    if experiment.disturbance_rad:
        name += "-disturbed" if experiment.delay_s else "-disturbed-punctual"
    return experiment.out / "results" / "generate" / task.name / f"{name}.jsonl"


def shards_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet, digest: str) -> Path:
    """Of the shards of what has this digest, each of which is an `out` of its own."""
    return experiment.out / "shards" / f"{task.name}-{constraint_set.name}-{digest}"


def corrected_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> Path:
    """The demonstrations, and those that correct what the policies of the round before have done."""
    return data_path(experiment, task, constraint_set).with_name(
        f"corrected-{arch.name}-{experiment.policies}.zarr"
    )


def correction_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> Path:
    name = f"{constraint_set.name}-{experiment.policies}.jsonl"
    return experiment.out / "results" / "correct" / task.name / arch.name / name


def policy_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> Path:
    return experiment.out / "policies" / task.name / constraint_set.name / arch.name / experiment.policies


def evaluation_path(experiment: Experiment, task: Task, constraint_set: ConstraintSet, arch: Arch) -> Path:
    how = experiment.method, experiment.learned_from, experiment.shield
    return experiment.out / rows_file(task.name, constraint_set.name, arch.name, *how)


def recording_path(
    experiment: Experiment, task: Task, constraint_set: ConstraintSet, stage: str, seed: int
) -> Path:
    return experiment.out / "recordings" / task.name / constraint_set.name / f"{stage}-{seed}.rrd"


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
