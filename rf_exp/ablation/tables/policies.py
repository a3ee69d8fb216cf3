"""Policies against each other: the architectures, and the same policies with and without a shield."""

from itertools import chain

from rf_exp.ablation.published import paper
from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, newest
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.cells import Rate, Text, Violations
from rf_exp.ablation.tables.counting import rates, violations
from rf_exp.ablation.tables.notes import ROLLOUT_VIOLATIONS
from rf_exp.ablation.tables.selection import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    both_ways,
    but_first,
    recipes_of,
    tasks_of,
    unshielded,
)
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations


def architectures(everything: Results, suite: Suite) -> Table:
    """The four architectures (paper, section 4.2), a row for each number of demonstrations at hand.

    Further recipes than the first have rows of the architectures that were measured, where they are several.
    """
    results = unshielded(everything)
    rows = [row for row in results.evaluation if row.constraints == BASELINE_CONSTRAINTS]
    names, recipes = tasks_of(paper().architectures[BASELINE_ARCH], rows), recipes_of(rows)
    columns = (
        Column("demos", "Demos", Text),
        Column("recipe", "Recipe", Text),
        *chain.from_iterable(with_violations(name, title_of(name, suite)) for name in names),
    )
    lines, gaps = [], []
    at_hand = sorted({(recipes.index(row.recipe), row.demos) for row in rows})
    for order, demos in at_hand or [(0, paper().demos[-1])]:
        recipe = recipes[order]
        alike = [r for r in rows if (r.demos, r.recipe) == (demos, recipe)]
        known, found = paper().architectures, {row.arch for row in alike}
        archs = [*known, *sorted({row.arch for row in rows} - {*known})]
        if order:
            archs = [arch for arch in archs if arch in found] if len(found) > 1 else []
        end = f"-{demos}{but_first(recipe, recipes)}"
        some = [_architecture(arch, end, Text(str(demos)), Text(recipe), alike, names) for arch in archs]
        lines += some
        gaps += _gaps(some, columns, f"{demos} demos, {recipe}")
    return Table(
        "architectures",
        "Architectures",
        "Success rate of the four architectures: shared or separate policy, global or local view. "
        + ROLLOUT_VIOLATIONS,
        "Architecture",
        columns,
        tuple(lines),
        (
            f"The paper's figures are with {paper().demos[-1]} demonstrations.",
            *gaps,
            *notes.coordinated(rows),
            *notes.left_out(results),
            *notes.shielded(everything),
            *notes.mixed_versions(lines, by_column=columns),
        ),
    )


def _architecture(
    arch: str, end: str, demos: Text, recipe: Text, rows: list[EvaluationRow], names: list[str]
) -> Line:
    """The line of an architecture, over rows of one number of demonstrations and one recipe."""
    figures = paper().architectures.get(arch, {})
    cells = (
        rates([r for r in rows if (r.arch, r.task) == (arch, name)], figures.get(name)) for name in names
    )
    return Line(f"{arch}{end}", arch, (demos, recipe, *chain.from_iterable(cells)))


def _gaps(lines: list[Line], columns: tuple[Column, ...], label: str) -> list[str]:
    """How far the architectures of some lines are apart, for each task."""
    found = []
    for index, column in enumerate(columns):
        cells = {line.title: line.cells[index] for line in lines}
        estimates = {arch: cell.estimate for arch, cell in cells.items() if isinstance(cell, Rate)}
        if estimates:
            found += notes.gaps(f"{column.title}, {label}", estimates, BASELINE_ARCH)
    return found


def shield(results: Results, suite: Suite) -> Table:
    """The same policies in the same scenes without and with a shield; a row for each that has both, or one.

    Only scenes that were rolled out both ways are compared, where there are such scenes.
    """
    groups: dict[tuple[str, str, int, str], list[EvaluationRow]] = {}
    for row in results.evaluation:
        if row.constraints == BASELINE_CONSTRAINTS:
            groups.setdefault((row.task, row.arch, row.demos, row.recipe), []).append(row)
    order = tasks_of([*paper().levels, *suite], results.evaluation)
    lines, gaps = [], []
    for task, arch, demos, recipe in sorted(groups, key=lambda group: (order.index(group[0]), *group[1:])):
        without, shielded = both_ways(newest(groups[task, arch, demos, recipe])[0])
        if not shielded:
            continue
        bare, guarded = rates(without, None), rates(shielded, None)
        cells = (
            *(Text(str(demos)), Text(recipe)),
            *(*bare, violations(without, "contacts")),
            *(*guarded, violations(shielded, "contacts"), violations(shielded, "interventions")),
        )
        title = f"{title_of(task, suite)}, {arch}"
        lines.append(Line(f"{task}-{arch}-{demos}-{recipe}", title, cells))
        estimates = {"with": guarded[0].estimate, "without": bare[0].estimate}
        gaps += notes.gaps(f"{title}, {demos} demos, {recipe}", estimates, "without")
    return Table(
        "shield",
        "Shielded rollouts",
        "The same policies in the same scenes, as they are and with RoboChecker between them and the arms: "
        "predicted chunks are checked before they are executed, and an arm that would come too close to "
        f"another one waits. {ROLLOUT_VIOLATIONS} Contacts and interventions alike: share of the rollouts, "
        "and mean number of control steps with a contact between arms, or with an arm that the shield kept "
        "from its command.",
        "Task, architecture",
        _shield_columns(),
        tuple(lines),
        (*gaps, *notes.coordinated(results.evaluation), *notes.left_out(results)),
    )


def _shield_columns() -> tuple[Column, ...]:
    return (
        Column("demos", "Demos", Text),
        Column("recipe", "Recipe", Text),
        *with_violations("without", "Without shield"),
        Column("without_contacts", "contacts", Violations),
        *with_violations("with", "With shield"),
        Column("with_contacts", "contacts", Violations),
        Column("interventions", "interventions", Violations),
    )
