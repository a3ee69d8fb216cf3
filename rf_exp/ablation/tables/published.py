"""The paper's figures as a frozen value; the numbers are in `paper.yaml`. Rates are fractions here."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

Grid = Mapping[str, Mapping[str, float]]  # row -> task -> figure


@dataclass(frozen=True)
class Paper:
    """Every figure of the paper's tables."""

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
    """The paper, read once."""
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
