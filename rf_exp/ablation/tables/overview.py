"""Overview tables: the tasks of the suite, how far they are solved, and what other benchmarks cover."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, grouped
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.counting import (
    BASELINE_ARCH,
    BASELINE_BRAIN,
    BASELINE_CONSTRAINTS,
    average,
    core_minutes,
    demos_of,
    group_attempts,
    is_baseline,
    length,
    rates,
    recipe_suffix,
    recipes_of,
    tasks_of,
    unshielded,
)
from rf_exp.ablation.tables.inputs import Suite, agents_of, paper, title_of
from rf_exp.ablation.tables.table import (
    Cell,
    Column,
    Length,
    Line,
    Rate,
    Table,
    Text,
    Violations,
    text_columns,
    with_violations,
)

LEVEL = "Plan & Control"  # of every task here: RoboBrain answers with subgoals, policies with joint targets


def tasks(results: Results, suite: Suite) -> Table:
    """Every task: its description (paper, supplementary task table) and how far it is solved."""
    rows, attempts = unshielded(results), group_attempts(results)
    demos, recipe = demos_of(rows), recipes_of(rows)[0]
    baseline = [row for row in rows if is_baseline(row) and row.recipe == recipe]
    disturbed = any(row.disturbance_rad for row in results.generation)
    columns = (
        *text_columns(agents="Agents", criteria="Criteria version"),
        *with_violations("generated", "Data generation"),
        Column("length", "Episode length", Length),
        *(with_violations("disturbed", "Data generation, disturbed") if disturbed else ()),
        *_demos_columns(demos),
        *text_columns(description="Description", condition="Target condition"),
    )
    lines = []
    for task in tasks_of([*paper().levels, *suite], (*results.generation, *rows)):
        facts = suite.get(task)
        generated, disturbed_rows = (
            attempts.get((task, BASELINE_CONSTRAINTS, BASELINE_BRAIN, is_disturbed), [])
            for is_disturbed in (False, True)
        )
        cells = (
            Text(str(agents_of(task, suite) or "")),
            Text(facts.version if facts else ""),
            *rates(generated, paper().ablation_success["full"].get(task)),
            length(generated, paper().ablation_length["full"].get(task)),
            *(rates(disturbed_rows) if disturbed else ()),
            *_baseline_cells([row for row in baseline if row.task == task], task, demos),
            Text(facts.description if facts else ""),
            Text(facts.condition if facts else ""),
        )
        lines.append(Line(task, title_of(task, suite), cells))
    missing = [title_of(task, suite) for task in paper().levels if task not in suite]
    missing_notes = [f"Tasks of the paper without a configuration: {', '.join(missing)}."] if missing else []
    return Table(
        "tasks",
        "Tasks",
        f"All tasks: demonstrations made under all constraints by the {BASELINE_BRAIN} brain, and "
        f"{BASELINE_ARCH} policies that learnt from them (recipe {recipe}). {notes.ROLLOUT_VIOLATIONS} For "
        "data generation, share of the seeds with a proposal that ended in a violation, and the mean number "
        "of such proposals.",
        "Task",
        columns,
        tuple(lines),
        (*missing_notes, *notes.left_out(rows), *notes.shielded(results), *notes.mixed_versions(lines)),
    )


def benchmark(results: Results, suite: Suite) -> Table:
    """Success of the diffusion policy by number of agents and demonstrations (paper, DP baseline).

    The averages are over the paper's tasks with a number of agents, to compare with the paper's. The first
    recipe has a line for every task, measured or not; further ones, below, only for tasks with rows.
    """
    rows = unshielded(results)
    demos, recipes = demos_of(rows), recipes_of(rows)
    columns = (
        *text_columns(agents="Agents", recipe="Recipe"),
        *_demos_columns(demos),
        *text_columns(core_minutes="Core-minutes"),
    )
    measured = grouped(filter(is_baseline, rows), lambda row: (row.task, row.recipe))

    def lines_of(tasks: Iterable[str], recipe: str) -> Iterator[Line]:
        for task in tasks:
            own = measured.get((task, recipe), [])
            if not own and recipe != recipes[0]:
                continue
            by_demos = grouped((row for row in own if row.core_s), lambda row: row.demos)
            minutes = " / ".join(
                f"{core_minutes(demo_rows):.1f}" for _, demo_rows in sorted(by_demos.items())
            )
            texts = Text(str(agents_of(task, suite) or "")), Text(recipe)
            cells = (*texts, *_baseline_cells(own, task, demos), Text(minutes))
            yield Line(task + recipe_suffix(recipe, recipes), title_of(task, suite), cells)

    lines: list[Line] = []
    for recipe, agents in product(recipes, paper().averages):
        level = [name for name, count in paper().levels.items() if count == agents]
        level_lines = list(lines_of(level, recipe))
        lines += level_lines
        if len(level_lines) == len(level):
            key = f"average_{agents}{recipe_suffix(recipe, recipes)}"
            lines.append(_average(key, agents, recipe, columns, level_lines))
    other_tasks = [name for name in tasks_of(suite, rows) if name not in paper().levels]
    for recipe in recipes:
        lines += lines_of(other_tasks, recipe)
    return Table(
        "benchmark",
        "Diffusion policy baseline",
        f"Success rate of {BASELINE_ARCH} policies by number of demonstrations. {notes.ROLLOUT_VIOLATIONS} "
        "Core-minutes: CPU time of learning, of all policies of the task together, at each of these numbers.",
        "Task",
        columns,
        tuple(lines),
        notes.left_out(rows) + notes.shielded(results) + notes.mixed_versions(lines),
    )


def _demos_columns(demos: Iterable[int]) -> Iterator[Column]:
    for count in demos:
        yield from with_violations(f"demos_{count}", f"{count} demos", demos=count)


def _baseline_cells(rows: Sequence[EvaluationRow], task: str, demos: Iterable[int]) -> Iterator[Cell]:
    """A rate with its violations for each number of demonstrations, of rows of one task and recipe."""
    for count in demos:
        paper_value = paper().baseline.get(task, {}).get(count)
        yield from rates([row for row in rows if row.demos == count], paper_value)


def _average(key: str, agents: int, recipe: str, columns: Sequence[Column], lines: Sequence[Line]) -> Line:
    """The line of averages below the tasks with a number of agents."""
    cells: list[Cell] = [Text(str(agents)), Text(recipe)]
    for index, column in enumerate(columns):
        averaged = [cell for line in lines if isinstance(cell := line.cells[index], Rate | Violations)]
        if averaged:
            paper_value = None if column.demos is None else paper().averages[agents].get(column.demos)
            cells.append(average(averaged, paper_value))
    return Line(key, "Average", (*cells, Text("")), average=True)


def comparison(results: Results, suite: Suite) -> Table:
    """What embodied benchmarks cover (paper, comparison of benchmarks), and this suite by its tasks."""
    columns = text_columns(single="Single-agent", multi="Multi-agent", level="Task level")
    counts = [task.agents for task in suite.values()]
    this_suite = (1 in counts, any(agents > 1 for agents in counts), LEVEL)
    lines = []
    for name, (single, multi, level) in {**paper().comparison, "This suite": this_suite}.items():
        texts = ("yes" if single else "no", "yes" if multi else "no", level)
        lines.append(Line(name, name, tuple(map(Text, texts))))
    levels = ", ".join(f"{n} with {agents}" for agents, n in sorted(Counter(counts).items()))
    caption = (
        f"Embodied benchmarks. This suite has {len(suite)} tasks, by number of agents: {levels or 'none'}."
    )
    return Table("comparison", "Comparison of benchmarks", caption, "Benchmark", columns, tuple(lines))
