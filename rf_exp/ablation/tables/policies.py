"""Tables that compare policies: architectures, recipes, shield, final scenes, and foreign policies."""

from collections.abc import Iterable, Mapping
from itertools import chain
from operator import attrgetter
from typing import Any, TypeVar

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import FINAL_SEED, EvaluationRow, grouped, newest
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.counting import (
    BASELINE_ARCH,
    is_baseline,
    rates,
    recipe_suffix,
    recipes_of,
    split_by_shield,
    tasks_of,
    unshielded,
    violations,
    with_all_constraints,
)
from rf_exp.ablation.tables.inputs import Suite, paper, title_of
from rf_exp.ablation.tables.table import (
    Cell,
    Column,
    Line,
    Table,
    Text,
    Violations,
    text_columns,
    with_violations,
)
from rf_exp.types import FOREIGN

Policy = TypeVar("Policy", bound=tuple[Any, ...])  # its task, and further parts of its key


def architectures(results: Results, suite: Suite) -> Table:
    """The four architectures (paper, section 4.2), a row for each number of demonstrations with rollouts.

    Recipes after the first have rows only for architectures that were measured, where these are several.
    """
    unshielded_rows = unshielded(results)
    rows = with_all_constraints(unshielded_rows)
    paper_rates, names = paper().architectures, tasks_of(paper().architectures[BASELINE_ARCH], rows)
    recipes = recipes_of(rows)
    columns = (
        *text_columns(demos="Demos", recipe="Recipe"),
        *chain.from_iterable(with_violations(name, title_of(name, suite)) for name in names),
    )
    lines, gaps = [], []
    measured = sorted({(recipes.index(row.recipe), row.demos) for row in rows})
    for recipe_index, demos in measured or [(0, paper().demos[-1])]:
        recipe = recipes[recipe_index]
        by_arch = grouped(
            (row for row in rows if (row.demos, row.recipe) == (demos, recipe)), lambda row: row.arch
        )
        archs = [*paper_rates, *sorted({row.arch for row in rows} - {*paper_rates})]
        if recipe_index:
            archs = [arch for arch in archs if arch in by_arch] if len(by_arch) > 1 else []
        arch_lines = []
        for arch in archs:
            cells = _by_task(
                by_arch.get(arch, []), {name: paper_rates.get(arch, {}).get(name) for name in names}
            )
            key = f"{arch}-{demos}{recipe_suffix(recipe, recipes)}"
            arch_lines.append(Line(key, arch, (Text(str(demos)), Text(recipe), *cells)))
        lines += arch_lines
        gaps += notes.difference_notes_by_column(
            arch_lines, columns, BASELINE_ARCH, f"{demos} demos, {recipe}"
        )
    return Table(
        "architectures",
        "Architectures",
        "Success rate of the four architectures: shared or separate policy, global or local view. "
        + notes.ROLLOUT_VIOLATIONS,
        "Architecture",
        columns,
        tuple(lines),
        (
            f"The paper's figures are with {paper().demos[-1]} demonstrations.",
            *gaps,
            *notes.coordinated(rows),
            *notes.left_out(unshielded_rows),
            *notes.shielded(results),
            *notes.mixed_versions(lines, by_column=columns),
        ),
    )


def recipes(results: Results, suite: Suite) -> Table:
    """Success by recipe, where several were trained on the same task with equally many demonstrations.

    conf/experiment/policy_ablation.yaml makes this comparison.
    """
    rows = [row for row in unshielded(results) if is_baseline(row)]
    by_task_and_demos = grouped(rows, lambda row: (row.task, row.demos))
    rows = [
        row for row in rows if len({other.recipe for other in by_task_and_demos[row.task, row.demos]}) > 1
    ]
    order, compared_tasks = recipes_of(rows), {row.task for row in rows}
    tasks = [task for task in tasks_of([*paper().levels, *suite], rows) if task in compared_tasks]
    columns = (
        *text_columns(demos="Demos"),
        *chain.from_iterable(with_violations(task, title_of(task, suite)) for task in tasks),
    )
    lines, gaps = [], []
    for demos in sorted({row.demos for row in rows}):
        measured = grouped((row for row in rows if row.demos == demos), lambda row: row.recipe)
        figures = {task: paper().baseline.get(task, {}).get(demos) for task in tasks}
        recipe_lines = [
            Line(f"{recipe}-{demos}", recipe, (Text(str(demos)), *_by_task(measured[recipe], figures)))
            for recipe in order
            if recipe in measured
        ]
        lines += recipe_lines
        gaps += notes.difference_notes_by_column(recipe_lines, columns, order[0], f"{demos} demos")
    return Table(
        "recipes",
        "Recipes",
        f"Success rate of {BASELINE_ARCH} policies by recipe, in the same scenes. {notes.ROLLOUT_VIOLATIONS}",
        "Recipe",
        columns,
        tuple(lines),
        (*gaps, *notes.mixed_versions(lines, by_column=columns)),
    )


def _by_task(rows: list[EvaluationRow], paper_values: dict[str, float | None]) -> tuple[Cell, ...]:
    """A rate with its violations for each task, beside the paper's figure."""
    cells = (
        rates([row for row in rows if row.task == task], paper_value)
        for task, paper_value in paper_values.items()
    )
    return tuple(chain.from_iterable(cells))


def _by_task_first(
    groups: Mapping[Policy, list[EvaluationRow]], task_order: Iterable[str]
) -> list[tuple[Policy, list[EvaluationRow]]]:
    """Groups of rows, whose keys begin with their task, by the order of tasks and then by their keys."""
    order = tasks_of(task_order, chain.from_iterable(groups.values()))
    return sorted(groups.items(), key=lambda item: (order.index(item[0][0]), *item[0][1:]))


def shield(results: Results, suite: Suite) -> Table:
    """The same policies in the same scenes without and with a shield; a row for each that has shielded ones.

    Only scenes that were rolled out both ways are compared, where there are such scenes.
    """
    groups = grouped(with_all_constraints(results.evaluation), attrgetter("task", "arch", "demos", "recipe"))
    lines, gaps = [], []
    for (task, arch, demos, recipe), rows in _by_task_first(groups, [*paper().levels, *suite]):
        without, shielded = split_by_shield(newest(rows)[0])
        if not shielded:
            continue
        without_cells, with_cells = rates(without), rates(shielded)
        cells = (
            *(Text(str(demos)), Text(recipe)),
            *(*without_cells, violations(without, "contacts")),
            *(*with_cells, violations(shielded, "contacts"), violations(shielded, "interventions")),
        )
        title = f"{title_of(task, suite)}, {arch}"
        lines.append(Line(f"{task}-{arch}-{demos}-{recipe}", title, cells))
        estimates = {"with": with_cells[0].estimate, "without": without_cells[0].estimate}
        gaps += notes.difference_notes(f"{title}, {demos} demos, {recipe}", estimates, "without")
    return Table(
        "shield",
        "Shielded rollouts",
        "The same policies in the same scenes, as they are and with RoboChecker between them and the arms: "
        "predicted chunks are checked before they are executed, and an arm that would come too close to "
        f"another one waits. {notes.ROLLOUT_VIOLATIONS} Contacts and interventions alike: share of the "
        "rollouts, and mean number of control steps with a contact between arms, or with an arm that the "
        "shield kept from its command.",
        "Task, architecture",
        (
            *text_columns(demos="Demos", recipe="Recipe"),
            *with_violations("without", "Without shield"),
            Column("without_contacts", "contacts", Violations),
            *with_violations("with", "With shield"),
            Column("with_contacts", "contacts", Violations),
            Column("interventions", "interventions", Violations),
        ),
        tuple(lines),
        (*gaps, *notes.coordinated(results.evaluation), *notes.left_out(results.evaluation)),
    )


def final(results: Results, suite: Suite) -> Table:
    """A row for each policy with rollouts in final scenes: success there and in the other tables' scenes."""
    policies = attrgetter("task", "arch", "constraints", "demos", "recipe")
    groups = grouped(unshielded(results), policies)
    lines = []
    for (task, arch, constraints, demos, recipe), group in _by_task_first(groups, [*paper().levels, *suite]):
        rows = newest(group)[0]
        if not any(row.final for row in rows):
            continue
        texts = Text(recipe), Text(arch), Text(constraints), Text(str(demos))
        split_cells = (rates([row for row in rows if row.final is is_final]) for is_final in (False, True))
        key = "-".join([task, arch, constraints, str(demos), recipe])
        lines.append(Line(key, title_of(task, suite), (*texts, *chain.from_iterable(split_cells))))
    return Table(
        "final",
        "Final scenes",
        "The scenes of all other tables have decided between recipes; on final scenes, with seeds from "
        f"{FINAL_SEED} on, nothing was ever chosen. The same policies in both. {notes.ROLLOUT_VIOLATIONS}",
        "Task",
        (
            *text_columns(recipe="Recipe", arch="Architecture", constraints="Constraints", demos="Demos"),
            *with_violations("trial", "Scenes of the tables"),
            *with_violations("final", "Final scenes"),
        ),
        tuple(lines),
        notes.mixed_versions(lines),
    )


def foreign(results: Results, suite: Suite) -> Table:
    """A row for each foreign policy and each task, with separate rows for shielded rollouts."""
    rows = [row for row in results.evaluation if row.arch == FOREIGN.name]
    groups = grouped(with_all_constraints(rows), attrgetter("task", "recipe", "demos", "shield"))
    lines = []
    for (task, name, demos, shielded), group in _by_task_first(groups, suite):
        observed = "true poses" if group[-1].observation == "state" else "what can be measured"
        cells = (
            *(Text(str(demos)), Text(observed), Text("yes" if shielded else "no")),
            *(*rates(group), violations(group, "contacts")),
        )
        line = f"{task}-{name}-{demos}{'-shield' * shielded}"
        lines.append(Line(line, f"{title_of(task, suite)}, {name}", cells))
    return Table(
        "foreign",
        "Policies of others",
        "Policies that this suite has not trained, in the scenes and by the criteria of those that it has. "
        f"{notes.ROLLOUT_VIOLATIONS} Contacts alike. Demos: demonstrations of this suite that they learned "
        "from, as the person said who evaluated them.",
        "Task, policy",
        (
            *text_columns(demos="Demos", told="Observations", shield="Shield"),
            *with_violations("success", "Success"),
            Column("contacts", "contacts", Violations),
        ),
        tuple(lines),
        notes.left_out(rows),
    )
