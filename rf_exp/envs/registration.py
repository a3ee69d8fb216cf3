"""By which names the environments are found: those of the tasks."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.observations import Observations
from rf_exp.tasks import CONFIGURED, Task, read_task

if TYPE_CHECKING:
    from rf_exp.envs.parallel import ParallelArmsEnv

VERSION = 1  # of the interface: raise it when observations, actions or reward come to mean something else


def configured() -> tuple[str, ...]:
    """The names of the tasks of conf/task."""
    return tuple(sorted(path.stem for path in CONFIGURED.glob("*.yaml")))


def find_task(task: "str | Path | Task") -> Task:
    """A task by its name, the path of its YAML file, or itself.

    Raises ArgumentError for a name or a file that is not there, and for a file that is no task.
    """
    if isinstance(task, Task):
        return task
    if str(task) in configured():
        return read_task(CONFIGURED / f"{task}.yaml")
    path = Path(task)
    if path.suffix != ".yaml":
        raise choices("task", str(task), (*configured(), "the path of a task's YAML file"))
    if not path.is_file():
        raise ArgumentError(f"task {str(task)!r}: there is no such file")
    return read_task(path)


def environment_id(name: str) -> str:
    """The name of a task's environment in Gymnasium."""
    return f"rf_exp/{name}-v{VERSION}"


def register(path: str | Path) -> str:
    """Registers the task of a YAML file with Gymnasium; the name for `gymnasium.make`.

    Modules that the file names (`code`, assets) must be importable. Raises ArgumentError as `find_task`.
    """
    return _register(find_task(Path(path)).name, str(Path(path).resolve()))


def register_configured() -> None:
    """Registers every task of conf/task."""
    for name in configured():
        _register(name, name)


def _register(name: str, task: str) -> str:
    gymnasium.register(
        environment_id(name), entry_point="rf_exp.envs.central:CentralEnv", kwargs={"task": task}
    )
    return environment_id(name)


def parallel_env(
    task: "str | Path | Task", observations: Observations | None = None, **options: Any
) -> "ParallelArmsEnv":
    """The PettingZoo environment of a task: its name, the path of its YAML file, or itself.

    `options` are those of `ParallelArmsEnv`. Raises StageError where PettingZoo is not installed.
    """
    try:
        from rf_exp.envs.parallel import ParallelArmsEnv  # not above: Gymnasium alone does without PettingZoo
    except ModuleNotFoundError as error:
        if error.name != "pettingzoo":
            raise
        raise StageError("PettingZoo is not installed; run: pip install 'rf_exp[envs]'") from error
    return ParallelArmsEnv(task, observations, **options)
