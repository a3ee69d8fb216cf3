"""Inputs of tables beside rows: the paper's figures, which are in `paper.yaml`, and facts about tasks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from rf_exp.tasks import (
    CONFIGURED,
    Task,
    parse_family_name,
    read_task,
    release_label,
    split_marks,
    split_robots,
)

Grid = Mapping[str, Mapping[str, float]]  # row -> task -> figure


@dataclass(frozen=True)
class Paper:
    """Every figure of the paper's tables. Rates are fractions here."""

    source: str
    levels: Mapping[str, int]  # task -> number of agents, in the order of the baseline table
    baseline: Mapping[str, Mapping[int, float]]  # task -> demonstrations -> rate
    averages: Mapping[int, Mapping[int, float]]  # agents -> demonstrations -> rate, as printed
    architectures: Grid  # rates
    ablation_success: Grid  # rates
    ablation_length: Grid  # control steps
    comparison: Mapping[str, tuple[bool, bool, str]]  # single-agent, multi-agent, task level

    @property
    def demos(self) -> tuple[int, ...]:
        """Numbers of demonstrations of the baseline."""
        return tuple(next(iter(self.baseline.values())))


@cache
def paper() -> Paper:
    """The paper's figures, read once."""
    raw: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("paper.yaml").read_text("utf-8"))

    def by_demos(figures: list[float]) -> dict[int, float]:
        return {demos: rate / 100 for demos, rate in zip(raw["demos"], figures, strict=True)}

    def rates(grid: Grid) -> Grid:
        return {row: {task: rate / 100 for task, rate in cells.items()} for row, cells in grid.items()}

    return Paper(
        source=raw["source"],
        levels={task: agents for agents, tasks in raw["levels"].items() for task in tasks},
        baseline={task: by_demos(figures) for task, figures in raw["baseline"].items()},
        averages={agents: by_demos(figures) for agents, figures in raw["averages"].items()},
        architectures=rates(raw["architectures"]),
        ablation_success=rates(raw["ablation_success"]),
        ablation_length=raw["ablation_length"],
        comparison={name: tuple(row) for name, row in raw["comparison"].items()},
    )


@dataclass(frozen=True)
class TaskFacts:
    """Facts about one task, from its YAML file: plain values, no simulator."""

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


def title_of(task: str, suite: Suite) -> str:
    """The configured title of a task; where it is not in the suite its name in title case."""
    if task in suite:
        return suite[task].title
    base, marks = split_marks(task)
    if marks:
        return f"{title_of(base, suite)} ({release_label(marks)})"
    base, robots = split_robots(task)
    if robots:
        return f"{title_of(base, suite)} ({', '.join(robots)})"
    family, *numbers = parse_family_name(task) or (task,)
    return f"{family.replace('_', ' ').title()} {' x '.join(map(str, numbers))}".strip()


def agents_of(task: str, suite: Suite) -> int | None:
    if task in suite:
        return suite[task].agents
    base, _ = split_robots(split_marks(task)[0])
    if base != task:
        return agents_of(base, suite)
    _, arms, _ = parse_family_name(task) or (None, None, None)
    return arms or paper().levels.get(task)
