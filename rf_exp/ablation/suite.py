"""What the tables say about the tasks themselves, read from the configuration: plain values, no simulator."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rf_exp.tasks import CONFIGURED, Task, read_task


@dataclass(frozen=True)
class TaskFacts:
    """One task, in the words of its YAML file."""

    title: str
    agents: int
    description: str
    condition: str
    version: str  # of the success criteria


Suite = Mapping[str, TaskFacts]  # by the name of the task


def facts(tasks: Iterable[Task]) -> Suite:
    """The facts about tasks that were composed elsewhere."""
    return {
        task.name: TaskFacts(
            task.title, len(task.agents), task.description, task.target_condition, task.version
        )
        for task in tasks
    }


@cache
def configured(folder: Path = CONFIGURED) -> Suite:
    """The facts about every task in a folder of YAML files, whether it was ever run or not.

    Raises ArgumentError, as any run would, for a file that is no valid task.
    """
    return facts(read_task(path) for path in sorted(folder.glob("*.yaml")))
