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
    both_ways,
    but_first,
    is_baseline,
    rates,
    recipes_of,
    tasks_of,
    under_all,
    unshielded,
    violations,
)
from rf_exp.ablation.tables.known import Suite, paper, title_of
from rf_exp.ablation.tables.table import (
    Cell,
    Column,
    Line,
    Table,
    Text,
    Violations,
    of_texts,
    with_violations,
)
from rf_exp.types import FOREIGN

Policy = TypeVar("Policy", bound=tuple[Any, ...])  # its task, and further parts of its key


def architectures(results: Results, suite: Suite) -> Table:
    """The four architectures (paper, section 4.2), a row for each number of demonstrations with rollouts.

    Recipes after the first have rows only for architectures that were measured, where these are several.
    """
    everything = unshielded(results)
    rows = under_all(everything)
    known, names = paper().architectures, tasks_of(paper().architectures[BASELINE_ARCH], rows)
    recipes = recipes_of(rows)
    columns = (
        *of_texts(demos="Demos", recipe="Recipe"),
        *chain.from_iterable(with_violations(name, title_of(name, suite)) for name in names),
    )
    lines, gaps = [], []
    at_hand = sorted({(recipes.index(row.recipe), row.demos) for row in rows})
    for order, demos in at_hand or [(0, paper().demos[-1])]:
        recipe = recipes[order]
        alike = grouped(
            (row for row in rows if (row.demos, row.recipe) == (demos, recipe)), lambda row: row.arch
        )
        archs = [*known, *sorted({row.arch for row in rows} - {*known})]
        if order:
            archs = [arch for arch in archs if arch in alike] if len(alike) > 1 else []
        some = []
        for arch in archs:
            cells = _by_task(alike.get(arch, []), {name: known.get(arch, {}).get(name) for name in names})
            key = f"{arch}-{demos}{but_first(recipe, recipes)}"
            some.append(Line(key, arch, (Text(str(demos)), Text(recipe), *cells)))
        lines += some
        gaps += notes.gaps_by_column(some, columns, BASELINE_ARCH, f"{demos} demos, {recipe}")
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
            *notes.left_out(everything),
            *notes.shielded(results),
            *notes.mixed_versions(lines, by_column=columns),
        ),
    )


def recipes(results: Results, suite: Suite) -> Table:
    """Success by recipe, where several were trained on the same task with equally many demonstrations.

    conf/experiment/policy_ablation.yaml makes this comparison.
    """
    rows = [row for row in unshielded(results) if is_baseline(row)]
    alike = grouped(rows, lambda row: (row.task, row.demos))
    rows = [row for row in rows if len({each.recipe for each in alike[row.task, row.demos]}) > 1]
    order, present = recipes_of(rows), {row.task for row in rows}
    tasks = [task for task in tasks_of([*paper().levels, *suite], rows) if task in present]
    columns = (
        *of_texts(demos="Demos"),
        *chain.from_iterable(with_violations(task, title_of(task, suite)) for task in tasks),
    )
    lines, gaps = [], []
    for demos in sorted({row.demos for row in rows}):
        measured = grouped((row for row in rows if row.demos == demos), lambda row: row.recipe)
        figures = {task: paper().baseline.get(task, {}).get(demos) for task in tasks}
        some = [
            Line(f"{recipe}-{demos}", recipe, (Text(str(demos)), *_by_task(measured[recipe], figures)))
            for recipe in order
            if recipe in measured
        ]
        lines += some
        gaps += notes.gaps_by_column(some, columns, order[0], f"{demos} demos")
    return Table(
        "recipes",
        "Recipes",
        f"Success rate of {BASELINE_ARCH} policies by recipe, in the same scenes. {notes.ROLLOUT_VIOLATIONS}",
        "Recipe",
        columns,
        tuple(lines),
        (*gaps, *notes.mixed_versions(lines, by_column=columns)),
    )


def _by_task(rows: list[EvaluationRow], figures: dict[str, float | None]) -> tuple[Cell, ...]:
    """A rate with its violations for each task, beside the paper's figure."""
    cells = (rates([row for row in rows if row.task == task], figure) for task, figure in figures.items())
    return tuple(chain.from_iterable(cells))


def _by_task_first(
    groups: Mapping[Policy, list[EvaluationRow]], known: Iterable[str]
) -> list[tuple[Policy, list[EvaluationRow]]]:
    """Groups of rows, whose keys begin with their task, by the order of tasks and then by their keys."""
    order = tasks_of(known, chain.from_iterable(groups.values()))
    return sorted(groups.items(), key=lambda item: (order.index(item[0][0]), *item[0][1:]))


def shield(results: Results, suite: Suite) -> Table:
    """The same policies in the same scenes without and with a shield; a row for each that has shielded ones.

    Only scenes that were rolled out both ways are compared, where there are such scenes.
    """
    groups = grouped(under_all(results.evaluation), attrgetter("task", "arch", "demos", "recipe"))
    lines, gaps = [], []
    for (task, arch, demos, recipe), rows in _by_task_first(groups, [*paper().levels, *suite]):
        without, shielded = both_ways(newest(rows)[0])
        if not shielded:
            continue
        bare, guarded = rates(without), rates(shielded)
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
        f"another one waits. {notes.ROLLOUT_VIOLATIONS} Contacts and interventions alike: share of the "
        "rollouts, and mean number of control steps with a contact between arms, or with an arm that the "
        "shield kept from its command.",
        "Task, architecture",
        (
            *of_texts(demos="Demos", recipe="Recipe"),
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
    for (task, arch, constraints, demos, recipe), some in _by_task_first(groups, [*paper().levels, *suite]):
        rows = newest(some)[0]
        if not any(row.final for row in rows):
            continue
        told = Text(recipe), Text(arch), Text(constraints), Text(str(demos))
        split = (rates([row for row in rows if row.final is which]) for which in (False, True))
        key = "-".join([task, arch, constraints, str(demos), recipe])
        lines.append(Line(key, title_of(task, suite), (*told, *chain.from_iterable(split))))
    return Table(
        "final",
        "Final scenes",
        "The scenes of all other tables have decided between recipes; on final scenes, with seeds from "
        f"{FINAL_SEED} on, nothing was ever chosen. The same policies in both. {notes.ROLLOUT_VIOLATIONS}",
        "Task",
        (
            *of_texts(recipe="Recipe", arch="Architecture", constraints="Constraints", demos="Demos"),
            *with_violations("trial", "Scenes of the tables"),
            *with_violations("final", "Final scenes"),
        ),
        tuple(lines),
        notes.mixed_versions(lines),
    )


def foreign(results: Results, suite: Suite) -> Table:
    """A row for each foreign policy and each task, with separate rows for shielded rollouts."""
    rows = [row for row in results.evaluation if row.arch == FOREIGN.name]
    groups = grouped(under_all(rows), attrgetter("task", "recipe", "demos", "shield"))
    lines = []
    for (task, name, demos, guarded), some in _by_task_first(groups, suite):
        told = "true poses" if some[-1].observation == "state" else "what can be measured"
        cells = (
            *(Text(str(demos)), Text(told), Text("yes" if guarded else "no")),
            *(*rates(some), violations(some, "contacts")),
        )
        line = f"{task}-{name}-{demos}{'-shield' * guarded}"
        lines.append(Line(line, f"{title_of(task, suite)}, {name}", cells))
    return Table(
        "foreign",
        "Policies of others",
        "Policies that this suite has not trained, in the scenes and by the criteria of those that it has. "
        f"{notes.ROLLOUT_VIOLATIONS} Contacts alike. Demos: demonstrations of this suite that they learned "
        "from, as the person said who evaluated them.",
        "Task, policy",
        (
            *of_texts(demos="Demos", told="Told", shield="Shield"),
            *with_violations("success", "Success"),
            Column("contacts", "contacts", Violations),
        ),
        tuple(lines),
        notes.left_out(rows),
    )
