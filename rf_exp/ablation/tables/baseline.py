"""The paper's benchmark: its diffusion policy by number of agents and demonstrations."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import product

from rf_exp.ablation.published import paper
from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.cells import Cell, Rate, Text, Violations
from rf_exp.ablation.tables.counting import average, rates
from rf_exp.ablation.tables.notes import ROLLOUT_VIOLATIONS
from rf_exp.ablation.tables.selection import (
    BASELINE_ARCH,
    agents_of,
    but_first,
    core_minutes,
    demos_of,
    is_baseline,
    recipes_of,
    tasks_of,
    unshielded,
)
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations


def benchmark(everything: Results, suite: Suite) -> Table:
    """Success of the diffusion policy by number of agents and demonstrations (paper, DP baseline).

    The averages are over the paper's tasks of a level, so that they stand beside the paper's. The first
    recipe has a line for every task, measured or not; below it, further ones have those of tasks with rows.
    """
    results = unshielded(everything)
    demos, recipes = demos_of(results), recipes_of(results.evaluation)
    columns = (
        Column("agents", "Agents", Text),
        Column("recipe", "Recipe", Text),
        *demos_columns(demos),
        Column("core_minutes", "Core-minutes", Text),
    )

    measured = {(row.recipe, row.task) for row in results.evaluation if is_baseline(row)}

    def has_line(task: str, recipe: str) -> bool:
        return recipe == recipes[0] or (recipe, task) in measured

    def line_of(task: str, recipe: str) -> Line:
        said = Text(str(agents_of(task, suite) or "")), Text(recipe)
        cells = baseline_cells(results, task, demos, recipe)
        cells = (*said, *cells, Text(_core_minutes(results, task, recipe)))
        return Line(task + but_first(recipe, recipes), title_of(task, suite), cells)

    lines = []
    for recipe, agents in product(recipes, paper().averages):
        level = [name for name, count in paper().levels.items() if count == agents]
        of_level = [line_of(name, recipe) for name in level if has_line(name, recipe)]
        lines += of_level
        if len(of_level) == len(level):
            key = f"average_{agents}{but_first(recipe, recipes)}"
            lines.append(_average(key, agents, recipe, columns, of_level))
    further = tasks_of([*paper().levels, *suite], results.evaluation)
    further = [name for name in further if name not in paper().levels]
    lines += [line_of(name, recipe) for recipe, name in product(recipes, further) if has_line(name, recipe)]
    return Table(
        "benchmark",
        "Diffusion policy baseline",
        f"Success rate of {BASELINE_ARCH} policies by number of demonstrations. {ROLLOUT_VIOLATIONS} "
        "Core-minutes: CPU time of learning, of all policies of the task together, at each of these numbers.",
        "Task",
        columns,
        tuple(lines),
        notes.left_out(results) + notes.shielded(everything) + notes.mixed_versions(lines),
    )


def demos_columns(demos: Iterable[int]) -> Iterator[Column]:
    for count in demos:
        yield from with_violations(f"demos_{count}", f"{count} demos", demos=count)


def baseline_cells(results: Results, task: str, demos: Iterable[int], recipe: str) -> Iterator[Cell]:
    ours = [r for r in results.evaluation if is_baseline(r) and (r.task, r.recipe) == (task, recipe)]
    for count in demos:
        rows = [r for r in ours if r.demos == count]
        yield from rates(rows, paper().baseline.get(task, {}).get(count))


def _average(key: str, agents: int, recipe: str, columns: Sequence[Column], lines: Sequence[Line]) -> Line:
    """The line of a level below those of its tasks."""
    cells: list[Cell] = [Text(str(agents)), Text(recipe)]
    for index, column in enumerate(columns):
        below = [cell for line in lines if isinstance(cell := line.cells[index], Rate | Violations)]
        if below:
            figure = None if column.demos is None else paper().averages[agents].get(column.demos)
            cells.append(average(below, figure))
    return Line(key, "Average", (*cells, Text("")), average=True)


def _core_minutes(results: Results, task: str, recipe: str) -> str:
    """At each number of demonstrations."""
    by_demos: dict[int, list[EvaluationRow]] = {}
    for row in results.evaluation:
        if is_baseline(row) and (row.task, row.recipe) == (task, recipe) and row.core_s:
            by_demos.setdefault(row.demos, []).append(row)
    return " / ".join(f"{core_minutes(rows):.1f}" for _, rows in sorted(by_demos.items()))
