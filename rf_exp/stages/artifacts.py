"""Where artifacts are, who may make them, and whether they fit the configuration.

The layout below `out` is a contract that other people's scripts rely on.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock

from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import Experiment
from rf_exp.tasks import Task
from rf_exp.types import Arch, Row


def data_path(experiment: Experiment, task: Task, row: Row) -> Path:
    return experiment.out / "data" / task.name / row.name / f"{experiment.name}.zarr"


def generation_path(experiment: Experiment, task: Task, row: Row) -> Path:
    return experiment.out / "results" / "generate" / task.name / f"{row.name}.jsonl"


def policy_path(experiment: Experiment, task: Task, row: Row, arch: Arch) -> Path:
    run = f"{experiment.demos}-{experiment.train_seed}"
    return experiment.out / "policies" / task.name / row.name / arch.name / run


def evaluation_path(experiment: Experiment, task: Task, row: Row, arch: Arch) -> Path:
    return (
        experiment.out
        / "results"
        / "evaluate"
        / task.name
        / arch.name
        / f"{row.name}-{experiment.demos}.jsonl"
    )


def recording_path(experiment: Experiment, task: Task, row: Row, stage: str, seed: int) -> Path:
    return experiment.out / "recordings" / task.name / row.name / f"{stage}-{seed}.rrd"


def plain(value: object) -> Any:
    """The value as JSON knows it, for comparing configurations of different runs."""
    return json.loads(json.dumps(value))


@contextmanager
def owned(artifact: Path, configuration: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Holds the right to make an artifact; other jobs that want it wait here until it is made.

    With `configuration`, that is written beside the artifact the first time and compared every
    other time. Raises StageError naming what differs, ArgumentError where nothing can be written.
    """
    try:
        artifact.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(artifact.with_name(f".{artifact.name}.lock"))
        lock.acquire()
    except OSError as error:
        raise ArgumentError(
            f"cannot write below {artifact.parent}: {error.strerror}; choose another folder with out=FOLDER"
        ) from error
    try:
        if configuration is not None:
            _same_configuration(artifact, plain(configuration))
        yield
    finally:
        lock.release()


@contextmanager
def complete(path: Path) -> Iterator[Path]:
    """Another name to write `path` under; it gets its own only when it is finished."""
    draft = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _same_configuration(artifact: Path, configuration: Mapping[str, Any]) -> None:
    path = artifact.with_name(f"{artifact.stem}.configuration.json")
    if not path.exists():
        path.write_text(json.dumps(configuration, indent=2) + "\n")
        return
    found = json.loads(path.read_text())
    differing = sorted(key for key in {*found, *configuration} if found.get(key) != configuration.get(key))
    if differing:
        listed = "; ".join(
            f"{key}: there {found.get(key)!r}, now {configuration.get(key)!r}" for key in differing
        )
        raise StageError(
            f"{artifact} was made with another configuration ({listed}); delete it, or choose another folder "
            "with out=FOLDER"
        )
