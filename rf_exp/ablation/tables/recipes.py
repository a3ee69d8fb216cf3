"""Recipes against each other: what the ladder compares (conf/experiment/ladder.yaml)."""

from collections.abc import Iterator, Sequence
from itertools import chain

from rf_exp.ablation.published import paper
from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.cells import Rate, Text
from rf_exp.ablation.tables.counting import rates
from rf_exp.ablation.tables.selection import BASELINE_ARCH, is_baseline, recipes_of, tasks_of, unshielded
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations


def recipes(everything: Results, suite: Suite) -> Table:
    """Success by recipe, where several have learned the same task from as many demonstrations."""
    rows = [row for row in unshielded(everything).evaluation if is_baseline(row)]
    alike: dict[tuple[str, int], set[str]] = {}
    for row in rows:
        alike.setdefault((row.task, row.demos), set()).add(row.recipe)
    rows = [row for row in rows if len(alike[row.task, row.demos]) > 1]
    order = recipes_of(rows)
    tasks = [task for task in tasks_of([*paper().levels, *suite], rows) if any(r.task == task for r in rows)]
    columns = (
        Column("demos", "Demos", Text),
        *chain.from_iterable(with_violations(task, title_of(task, suite)) for task in tasks),
    )
    lines, gaps = [], []
    for demos in sorted({row.demos for row in rows}):
        of_demos = [row for row in rows if row.demos == demos]
        some = [_line(recipe, demos, of_demos, tasks) for recipe in order if _of(recipe, of_demos)]
        lines += some
        gaps += _gaps(some, columns, order, demos)
    return Table(
        "recipes",
        "Recipes",
        f"Success rate of {BASELINE_ARCH} policies by recipe, in the same scenes. {notes.ROLLOUT_VIOLATIONS}",
        "Recipe",
        columns,
        tuple(lines),
        (*gaps, *notes.mixed_versions(lines, by_column=columns)),
    )


def _of(recipe: str, rows: Sequence[EvaluationRow]) -> list[EvaluationRow]:
    return [row for row in rows if row.recipe == recipe]


def _line(recipe: str, demos: int, rows: Sequence[EvaluationRow], tasks: Sequence[str]) -> Line:
    cells = (
        rates(
            [row for row in _of(recipe, rows) if row.task == task], paper().baseline.get(task, {}).get(demos)
        )
        for task in tasks
    )
    return Line(f"{recipe}-{demos}", recipe, (Text(str(demos)), *chain.from_iterable(cells)))


def _gaps(
    lines: Sequence[Line], columns: Sequence[Column], order: Sequence[str], demos: int
) -> Iterator[str]:
    """How far the recipes of some lines are from the first one."""
    for index, column in enumerate(columns):
        cells = {line.title: line.cells[index] for line in lines}
        found = {recipe: cell.estimate for recipe, cell in cells.items() if isinstance(cell, Rate)}
        if order[0] in found:
            yield from notes.gaps(f"{column.title}, {demos} demos", found, order[0])
