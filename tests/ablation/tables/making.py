"""Tables from rows whose figures a test can count, their formats and their cells."""

import io
import random
from collections.abc import Iterator
from functools import cache
from typing import Any

from rich.console import Console

from rf_exp.ablation import EvaluationRow, GenerationRow, Results, formats, page, paper
from rf_exp.ablation.tables import TABLES
from rf_exp.ablation.tables.inputs import Suite, TaskFacts
from rf_exp.ablation.tables.table import Column, Length, Rate, Table
from tests.ablation.conftest import BUDGET, evaluation, generation

NAMES = ["tasks", "comparison", "benchmark", "architectures", "recipes", "shield"]
NAMES += ["ablation_success", "ablation_length", "foreign"]
EMPTY = Results()
SUITE = {
    "lift_barrier": TaskFacts("Lift Barrier", 2, "Two arms lift a barrier.", "It is up.", "1"),
    "take_photo": TaskFacts("Take Photo", 4, "Four arms take a photo.", "It is taken.", "1"),
}


def generated(*rows: list) -> Results:  # type: ignore[type-arg]
    return Results(generation=tuple(row for group in rows for row in group))


def evaluated(*rows: list) -> Results:  # type: ignore[type-arg]
    return Results(evaluation=tuple(row for group in rows for row in group))


def at(table: Table, line: str, column: str) -> Any:
    """The cell of a line and a column; untyped, as the test knows its kind."""
    return table.cell(line, column)


def made(name: str, results: Results, suite: Suite = SUITE) -> Table:
    return TABLES[name](results, suite)


def followers(table: Table) -> Iterator[tuple[Column, Column]]:
    """(column of a success rate, the column after it); in `ablation_length` also columns of lengths."""
    kinds = (Rate, Length) if table.name == "ablation_length" else (Rate,)
    for column, after in zip(table.columns, (*table.columns[1:], Column("end", "")), strict=True):
        if column.kind in kinds:
            yield column, after


@cache
def counted() -> tuple[dict[GenerationRow, int], dict[EvaluationRow, int]]:
    """Rows of every kind that tables distinguish -> their violations; of generation, and of evaluation."""
    rng = random.Random(5)
    made: dict[GenerationRow, int] = {}
    rolled: dict[EvaluationRow, int] = {}
    for task in (*paper().levels, "pour_tea"):
        for version in ("1", "2"):
            for constraints in (*paper().ablation_success, "no_logic"):
                for brain in ("scripted", "openai"):
                    some = [rng.choice((0, 0, 1, 2, BUDGET - 1, BUDGET)) for _ in range(7)]
                    rows = generation(task, constraints, 4, 3, brain=brain, version=version, violations=some)
                    made.update(zip(rows, some, strict=True))
            for arch in (*paper().architectures, "my_arch", "foreign"):
                for demos in (20, *paper().demos):
                    for constraints in ("full", "logical"):
                        for shield in (False, True):
                            some = [rng.choice((0, 0, 1, 70)) for _ in range(5)]
                            kind = {"version": version, "constraints": constraints, "shield": shield}
                            runs = evaluation(task, arch, demos, 2, 3, **kind, violations=some)
                            rolled.update(zip(runs, some, strict=True))
    return made, rolled


def by_hand(name: str, line: str, column: str) -> list[int]:
    """The violations behind one cell, picked from all rows of the newest version."""
    made, rolled = counted()
    if name.startswith("ablation") or column == "generated":
        constraints, _, brain = ("full" if column == "generated" else line).partition("-")
        task = line if column == "generated" else column
        wanted = (task, constraints, brain or "scripted", "2")
        return [
            n
            for row, n in made.items()
            if (row.task, row.constraints, row.brain, row.version) == wanted
            and (row.success or name != "ablation_length")
        ]
    shield = name == "shield" and column == "with"
    if name == "shield":
        task, arch, demos, _ = line.split("-")
    elif name == "foreign":
        (task, _, demos, *shielded), arch = line.split("-"), "foreign"
        shield = bool(shielded)
    elif name == "architectures":
        task, (arch, demos) = column, line.split("-")
    else:
        task, arch, demos = line, "separate_local", column.removeprefix("demos_")
    wanted = (task, arch, int(demos), "full", "2", shield)
    return [
        n
        for row, n in rolled.items()
        if (row.task, row.arch, row.demos, row.constraints, row.version, row.shield) == wanted
    ]


def html(table: Table) -> str:
    """The table on an HTML page."""
    section = page.Section(table.name, table.title, table=page.layout(table))
    return page.document("A page", "a paper", [section])


def shown(table: Table, styled: bool = False) -> str:
    """The table on a terminal of 80 columns."""
    terminal = io.StringIO()
    formats.show(
        table,
        Console(file=terminal, width=80, force_terminal=styled, color_system="standard" if styled else None),
    )
    return terminal.getvalue()
