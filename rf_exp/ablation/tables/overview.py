"""What the suite holds: its tasks and how far they are solved, and what other benchmarks cover."""

from collections import Counter

from rf_exp.ablation.published import paper
from rf_exp.ablation.results import Results
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.baseline import baseline_cells, demos_columns
from rf_exp.ablation.tables.cells import Cell, Length, Text
from rf_exp.ablation.tables.counting import length, rates
from rf_exp.ablation.tables.notes import ROLLOUT_VIOLATIONS
from rf_exp.ablation.tables.selection import (
    BASELINE_ARCH,
    BASELINE_BRAIN,
    BASELINE_CONSTRAINTS,
    agents_of,
    demos_of,
    generated,
    recipes_of,
    tasks_of,
    unshielded,
)
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations

LEVEL = "Plan & Control"  # of every task here: RoboBrain answers with subgoals, policies with joint targets


def tasks(everything: Results, suite: Suite) -> Table:
    """Every task: what it asks (paper, supplementary task table) and how far it is solved."""
    results = unshielded(everything)
    demos, recipe = demos_of(results), recipes_of(results.evaluation)[0]
    disturbed = any(row.disturbance_rad for row in results.generation)
    columns = (
        Column("agents", "Agents", Text),
        Column("criteria", "Criteria version", Text),
        *with_violations("generated", "Data generation"),
        Column("length", "Episode length", Length),
        *(with_violations("disturbed", "Data generation, disturbed") if disturbed else ()),
        *demos_columns(demos),
        Column("description", "Description", Text),
        Column("condition", "Target condition", Text),
    )
    listed = tasks_of([*paper().levels, *suite], (*results.generation, *results.evaluation))
    lines = tuple(
        Line(name, title_of(name, suite), _solved(results, suite, name, demos, recipe, disturbed))
        for name in listed
    )
    caption = (
        f"All tasks: demonstrations made under all constraints by the {BASELINE_BRAIN} brain, and "
        f"{BASELINE_ARCH} policies that learnt from them (recipe {recipe}). {ROLLOUT_VIOLATIONS} For data "
        "generation, share of "
        "the seeds with a proposal that ended in a violation, and the mean number of such proposals."
    )
    absent = [title_of(task, suite) for task in paper().levels if task not in suite]
    gap = [f"Tasks of the paper without a configuration: {', '.join(absent)}."] if absent else []
    said = (*gap, *notes.left_out(results), *notes.shielded(everything), *notes.mixed_versions(lines))
    return Table("tasks", "Tasks", caption, "Task", columns, lines, said)


def _solved(
    results: Results, suite: Suite, task: str, demos: list[int], recipe: str, disturbed: bool
) -> tuple[Cell, ...]:
    """The cells of one task."""
    known = suite.get(task)
    made, mended = (
        generated(results, task, BASELINE_CONSTRAINTS, BASELINE_BRAIN, way) for way in (False, True)
    )
    return (
        Text(str(agents_of(task, suite) or "")),
        Text(known.version if known else ""),
        *rates(made, paper().ablation_success["full"].get(task)),
        length(made, paper().ablation_length["full"].get(task)),
        *(rates(mended, None) if disturbed else ()),
        *baseline_cells(results, task, demos, recipe),
        Text(known.description if known else ""),
        Text(known.condition if known else ""),
    )


def comparison(results: Results, suite: Suite) -> Table:
    """What embodied benchmarks cover (paper, comparison of benchmarks), and this suite by its tasks."""
    columns = (
        Column("single", "Single-agent", Text),
        Column("multi", "Multi-agent", Text),
        Column("level", "Task level", Text),
    )
    counts = [task.agents for task in suite.values()]
    here = (1 in counts, any(agents > 1 for agents in counts), LEVEL)
    lines = []
    for name, (single, multi, level) in {**paper().comparison, "This suite": here}.items():
        texts = ("yes" if single else "no", "yes" if multi else "no", level)
        lines.append(Line(name, name, tuple(map(Text, texts))))
    levels = ", ".join(f"{n} with {agents}" for agents, n in sorted(Counter(counts).items()))
    caption = (
        f"Embodied benchmarks. This suite has {len(suite)} tasks, by number of agents: {levels or 'none'}."
    )
    return Table("comparison", "Comparison of benchmarks", caption, "Benchmark", columns, tuple(lines))
