"""Writes the pages of policies and their figure from the rows in results/evaluate: python docs/policies.py"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from statistics import fmean

from figure import Panel, figure
from omegaconf import OmegaConf
from origins import ORIGIN_COLUMNS, learned_with, origins

from rf_exp.ablation import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    EvaluationRow,
    configured,
    core_minutes,
    difference,
    is_baseline,
    load,
    newest,
    paper,
    split_by_shield,
    title_of,
    wilson,
    without_final,
    without_variation,
)
from rf_exp.artifacts import render_template
from rf_exp.tasks import CONFIGURED, read_task
from rf_exp.texts.markdown import table
from rf_exp.types import FOREIGN

ROOT = Path(__file__).parents[1]
POLICY_COLUMNS = (
    *("task", "architecture", "recipe", "demos", "strict", "95 % interval", "scenes", "paper's criterion"),
    *("the paper", "rollouts with a violation", "core-minutes", "queries"),
)
SHIELD_COLUMNS = (
    *("task", "demos", "scenes", "strict, without", "with"),
    *("violations, without", "with", "contacts, without", "with", "scenes in which it intervened"),
)
ABLATION_COLUMNS = (
    *("recipe", "change", "strict", "points above `fast`", "each training seed", "scenes"),
    *("rollouts with a violation", "core-minutes"),
)
MAX_FAILURE_KINDS = 3  # kinds of failures listed per policy
BASE_RECIPE = "paper_short"  # starting point of the ablation
ABLATION_CONFIG = ROOT / "conf" / "experiment" / "policy_ablation.yaml"

HERE = Path(__file__).parent
FIGURE = HERE / "images" / "policies.svg"

COMPARED_TASKS = [  # tasks that others report; the first RERUN_COUNT of them in a public rerun
    *("lift_barrier", "camera_alignment", "long_pipeline_delivery", "take_photo", "pass_shoe", "place_food"),
    *("two_robots_stack_cube", "three_robots_stack_cube"),
]
RERUN_COUNT = 6
CHALLENGE_BEST = {  # best result of a public rerun, per cent of 20 scenes by the release's criterion
    "place_cube_in_cup": 25,
    "strike_cube_hard": 95,
    "three_robots_place_shoes": 15,
    "four_robots_stack_cube": 20,
}
Cells = Mapping[tuple[str, str, int], list[EvaluationRow]]  # task, architecture, demonstrations


def rows_by_policy(rows: Iterable[EvaluationRow]) -> Iterator[tuple[EvaluationRow, list[EvaluationRow]]]:
    """(one of its rows, all its rows) of each policy, in the order of the paper's tasks."""
    groups: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row in rows:
        if row.constraints == BASELINE_CONSTRAINTS and row.arch != FOREIGN.name:
            key = (row.task, row.recipe, row.arch != BASELINE_ARCH, row.arch, row.demos, row.shield)
            groups.setdefault(key, []).append(row)
    order = [*paper().levels, *sorted({str(task) for task, *_ in groups} - {*paper().levels})]
    for _, group in sorted(groups.items(), key=lambda item: (order.index(str(item[0][0])), *item[0][1:])):
        newest_rows, _ = newest(group)
        yield newest_rows[0], list(newest_rows)


def paper_table_cells(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> Cells:
    """The groups for the cells of the paper's tables: recipe `fast`, without the shield."""
    return {
        (row.task, row.arch, row.demos): group
        for row, group in groups
        if row.recipe == "fast" and not row.shield
    }


def paper_figure(row: EvaluationRow) -> float | None:
    """The paper's rate for the same task, architecture and demonstrations; None with privileged state."""
    if row.observation == "state":
        return None
    if row.arch == BASELINE_ARCH:
        return paper().baseline.get(row.task, {}).get(row.demos)
    return paper().architectures.get(row.arch, {}).get(row.task) if row.demos == paper().demos[-1] else None


def strict(group: Sequence[EvaluationRow]) -> tuple[str, str]:
    """Strict success rate over the scenes, and its 95 % interval."""
    rate = wilson(sum(row.success for row in group), len(group))
    return f"**{percent(rate.value)}**", f"{100 * rate.low:.0f} to {100 * rate.high:.0f}"


def line(row: EvaluationRow, group: list[EvaluationRow]) -> tuple[str, ...]:
    figure, cost = paper_figure(row), core_minutes(group)
    return (
        title_of(row.task, configured()),
        row.arch + ", shielded" * row.shield,
        row.recipe,
        str(row.demos),
        *strict(group),
        str(len(group)),
        percent(fmean(r.success_paper for r in group)),
        "-" if figure is None else percent(figure),
        percent(fmean(r.violations > 0 for r in group)),
        f"{cost:.1f}" if cost else "",
        str(row.queries or "-"),
    )


@cache
def recipe_choices() -> Mapping[str, str]:
    """Recipe of the ablation -> its choice of `policy=`; `fast` first."""
    swept = str(OmegaConf.load(ABLATION_CONFIG).hydra.sweeper.params.policy).replace(",", " ").split()
    return {choice.rpartition("/")[2]: choice for choice in swept}


@cache
def ablated_recipes() -> list[str]:
    """Names of these recipes, as in rows."""
    return [*recipe_choices()]


def recipe_change(recipe: str) -> str:
    """Difference of a recipe from `fast`, from its first comment; empty for `fast`."""
    comment = (
        (ROOT / "conf" / "policy" / f"{recipe_choices().get(recipe, recipe)}.yaml")
        .read_text("utf-8")
        .splitlines()[1:3]
    )
    description = " ".join(line.removeprefix("# ") for line in comment if line.startswith("#"))
    description = description.removeprefix("Ablation: ")
    return "" if recipe == ablated_recipes()[0] else re.split(r"\.(?: [A-Z]|$)", description)[0]


def ablation(rows: Iterable[EvaluationRow], demos: int) -> list[tuple[str, str]]:
    """(task title, table) of the ablation: one line per recipe, all training seeds together."""
    recipes = [BASE_RECIPE, *ablated_recipes()]
    by_recipe: dict[tuple[str, str], list[EvaluationRow]] = {}
    for row in rows:
        if is_baseline(row) and not row.shield and row.demos == demos and row.recipe in recipes:
            by_recipe.setdefault((row.task, row.recipe), []).append(row)
    tables = []
    for task in paper().levels:
        if not any((task, recipe) in by_recipe for recipe in ablated_recipes()[1:]):
            continue
        groups = {r: list(newest(by_recipe[task, r])[0]) for r in recipes if (task, r) in by_recipe}
        lines = [
            recipe_line(recipe, group, groups.get(ablated_recipes()[0], []))
            for recipe, group in groups.items()
        ]
        tables.append((title_of(task, configured()), table(ABLATION_COLUMNS, lines)))
    return tables


def recipe_line(recipe: str, group: list[EvaluationRow], first: list[EvaluationRow]) -> tuple[str, ...]:
    """The line of a recipe, compared with the rollouts of the first one for the same training seeds."""
    seeds = sorted({row.train_seed for row in group})
    shares = [fmean(row.success for row in group if row.train_seed == seed) for seed in seeds]
    reference = [row for row in first if row.train_seed in seeds]
    rate, interval = strict(group)
    return (
        recipe,
        recipe_change(recipe),
        f"{rate} ({interval})",
        "" if not reference or group == first else rate_difference(group, reference),
        ", ".join(f"{100 * share:.0f}" for share in shares),
        str(len(group)),
        percent(fmean(row.violations > 0 for row in group)),
        f"{core_minutes(group):.1f}",
    )


def rate_difference(group: Sequence[EvaluationRow], other: Sequence[EvaluationRow]) -> str:
    """Difference in strict success to another group, percentage points, with the 95 % interval."""
    rates = (wilson(sum(row.success for row in each), len(each)) for each in (group, other))
    gap = difference(*rates)
    points, low, high = (f"{round(100 * each):+d}" for each in (gap.value, gap.low, gap.high))
    return f"{points} ({low} to {high})"


def failures(row: EvaluationRow, group: list[EvaluationRow]) -> str:
    """One line with the most frequent kinds of failure."""
    kinds = Counter(r.account.kind for r in group if not r.success)
    most_common = kinds.most_common(MAX_FAILURE_KINDS)
    listed = "; ".join(f"{kind} ({count})" for kind, count in most_common)
    others = sum(kinds.values()) - sum(count for _, count in most_common)
    name = f"{title_of(row.task, configured())}, {row.arch}, {row.recipe}, {row.demos}"
    return f"- **{name}{', shielded' * row.shield}**: {listed}{f'; others ({others})' if others else ''}."


def percent(share: float) -> str:
    """Whole per cent; one decimal where rounding would give 0 or 100 %."""
    rounded = round(100 * share)
    return f"{100 * share:.1f} %" if rounded in (0, 100) and rounded != 100 * share else f"{rounded} %"


def baseline(cells: Cells) -> str:
    """The paper's first table, with the mean over its tasks."""
    lines, columns = [], paper().demos
    for task, agents in paper().levels.items():
        figures = paper().baseline[task]
        rates = [
            rate_with_paper(cells.get((task, BASELINE_ARCH, demos)), figures[demos]) for demos in columns
        ]
        lines.append([title_of(task, configured()), str(agents), *rates])
    means = ["mean", ""]
    for demos in columns:
        groups = [cells.get((task, BASELINE_ARCH, demos)) for task in paper().levels]
        paper_mean = percent(fmean(paper().baseline[task][demos] for task in paper().levels))
        mean_rate = all(groups) and percent(fmean(rate(group) for group in groups if group))
        means.append(f"**{mean_rate}** ({paper_mean})" if mean_rate else f"- ({paper_mean})")
    return table(("task", "arms", *(f"{demos} demonstrations" for demos in columns)), [*lines, means])


def panels(cells: Cells) -> list[Panel]:
    """The paper's first table as panels of the figure."""
    figure_panels = []
    for task in paper().levels:
        groups = {n: cells.get((task, BASELINE_ARCH, n), []) for n in paper().demos}
        ours = {n: wilson(sum(r.success for r in group), len(group)) for n, group in groups.items() if group}
        figure_panels.append((title_of(task, configured()), ours, paper().baseline[task]))
    return figure_panels


def architectures(cells: Cells) -> str:
    """The paper's second table."""
    paper_rates, demos = paper().architectures, paper().demos[-1]
    task_names = {task for each in paper_rates.values() for task in each}
    task_names |= {
        task for task, arch, n in cells if arch in paper_rates and arch != BASELINE_ARCH and n == demos
    }
    tasks = [task for task in paper().levels if task in task_names]
    rows = [
        [arch, *(rate_with_paper(cells.get((task, arch, demos)), figures.get(task)) for task in tasks)]
        for arch, figures in paper_rates.items()
    ]
    return table(("architecture", *(title_of(task, configured()) for task in tasks)), rows)


def shielded(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> str:
    """Table of policies without and with the shield, in the same scenes."""
    by_policy: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row, group in groups:
        by_policy.setdefault((row.task, row.arch, row.recipe, row.demos), []).extend(group)
    lines = []
    for rows in by_policy.values():
        split, task, demos = split_by_shield(rows), title_of(rows[0].task, configured()), str(rows[0].demos)
        if not all(split):
            continue
        rates = (" (".join(strict(group)) + ")" for group in split)
        steps = [str(sum(row.violations for row in group)) for group in split]
        steps += [str(sum(row.contacts for row in group)) for group in split]
        intervened = percent(fmean(row.interventions > 0 for row in split[1]))
        lines.append((task, demos, str(len(split[1])), *rates, *steps, intervened))
    return table(SHIELD_COLUMNS, lines)


def privileged(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> str:
    """Table of privileged-state policies (`state`), beside policies from pictures (`fast`)."""
    by_task: dict[tuple[str, int], dict[str, list[EvaluationRow]]] = {}
    for row, group in groups:
        if is_baseline(row) and not row.shield and row.recipe in ("fast", "state"):
            by_task.setdefault((row.task, row.demos), {})[row.recipe] = group
    lines = [
        (
            title_of(task, configured()),
            str(demos),
            *(" (".join(strict(by_recipe[k])) + ")" for k in ("state", "fast")),
        )
        for (task, demos), by_recipe in by_task.items()
        if len(by_recipe) == 2
    ]
    return table(("task", "demos", "true poses", "pictures"), lines)


@cache
def step_limit(task: str) -> int:
    """Control steps after which a rollout of a task ends."""
    return read_task(CONFIGURED / f"{task}.yaml").step_limit


def late_successes(rows: Sequence[EvaluationRow]) -> dict[str, int]:
    """Number of successes of our policies, and of those beyond the present step limit of their task."""
    successes = [row for row in rows if row.success and row.arch != FOREIGN.name]
    return {"succeeded": len(successes), "later": sum(row.steps > step_limit(row.task) for row in successes)}


def cpu_hours(cells: Cells) -> tuple[str, str]:
    """Core-hours of training and of the rollouts of the first table, for one training seed."""
    groups = [
        cells.get((task, BASELINE_ARCH, demos), []) for task, demos in product(paper().levels, paper().demos)
    ]
    learning = sum(core_minutes(group) for group in groups) / 60
    scenes = (
        sum(row.wall_s / len({each.train_seed for each in group}) for group in groups for row in group) / 3600
    )
    return f"{learning:.1f}", f"{scenes:.1f}"


def comparison_lines(cells: Cells) -> dict[str, list[str]]:
    """Lines of the comparison with others: COMPARED_TASKS in per cent, and the mean of those in the rerun."""
    demos = paper().demos[-1]
    groups = [cells[task, BASELINE_ARCH, demos] for task in COMPARED_TASKS]
    rates = {
        "strict": [rate(group) for group in groups],
        "loose": [fmean(row.success_paper for row in group) for group in groups],
        "paper": [paper().baseline[task][demos] for task in COMPARED_TASKS],
    }
    return {
        name: [*(f"{100 * each:.0f}" for each in line), f"{100 * fmean(line[:RERUN_COUNT]):.1f}"]
        for name, line in rates.items()
    }


def challenge_lines(cells: Cells) -> dict[str, list[str]]:
    """Lines of the table of the challenge's four tasks; a dash for no measurement."""
    groups = [cells.get((task, BASELINE_ARCH, paper().demos[-1]), []) for task in CHALLENGE_BEST]

    def line(statistic: Callable[[Sequence[EvaluationRow]], float]) -> list[str]:
        return [f"{statistic(group):.0f}" if group else "-" for group in groups]

    return {
        "strict": line(lambda group: 100 * rate(group)),
        "loose": line(lambda group: 100 * fmean(row.success_paper for row in group)),
        "learning": line(core_minutes),
    }


def tasks_with_goal_gate(tables: Cells) -> str:
    """Titles of the tasks of the paper's tables whose policies with most demonstrations have a goal gate."""
    largest = {
        task: group
        for (task, arch, demos), group in tables.items()
        if (arch, demos) == (BASELINE_ARCH, paper().demos[-1])
    }
    gated = (task for task, group in largest.items() if learned_with(group[0], "policy.goal_gate"))
    return ", ".join(title_of(task, configured()) for task in gated)


def rate(group: Sequence[EvaluationRow]) -> float:
    return fmean(row.success for row in group)


def rate_with_paper(group: Sequence[EvaluationRow] | None, figure: float | None) -> str:
    """Strict rate with the paper's in brackets; a dash for no measurement."""
    ours = f"**{percent(rate(group))}**" if group else "-"
    return ours if figure is None else f"{ours} ({percent(figure)})"


def documents(rows: Sequence[EvaluationRow]) -> dict[Path, str]:
    """Path -> text of the pages: prose from templates, numbers from the rows."""
    groups = list(rows_by_policy(row for row in rows if row.recipe not in ablated_recipes()[1:]))
    table_cells = paper_table_cells(groups)
    failure_lines = [failures(row, group) for row, group in groups if not all(r.success for r in group)]
    policies_page = render_template(
        HERE / "policies.jinja",
        baseline=baseline(table_cells),
        architectures=architectures(table_cells),
        hours=cpu_hours(table_cells),
        compared=comparison_lines(table_cells),
        challenge=challenge_lines(table_cells),
        gated=tasks_with_goal_gate(table_cells),
        shielded=shielded(groups),
        privileged=privileged(groups),
        limits=late_successes(rows),
        every=table(POLICY_COLUMNS, (line(row, group) for row, group in groups)),
        origins=table(ORIGIN_COLUMNS, origins(row for row, _ in groups)),
        most=paper().demos[-1],
        failed="\n".join(failure_lines),
        commits=", ".join(sorted({row.commit for row in rows})),
    )
    ablation_demos, most_demos = OmegaConf.load(ABLATION_CONFIG).demos, paper().demos[-1]
    ablation_page = render_template(
        HERE / "recipe_ablation.jinja",
        ablation=ablation(rows, ablation_demos),
        heads=ablation(rows, most_demos),
        ablation_demos=ablation_demos,
        most=most_demos,
    )
    return {HERE / "policies.md": policies_page, HERE / "recipe_ablation.md": ablation_page}


def measured() -> Sequence[EvaluationRow]:
    """The published rows of the suite's tasks and robots in nominal scenes."""
    rows, suite = without_variation(without_final(load(ROOT))).evaluation, configured()
    return [row for row in rows if row.task in suite]


if __name__ == "__main__":
    rows = measured()
    for path, text in documents(rows).items():
        path.write_text(text, "utf-8")
    FIGURE.write_text(figure(panels(paper_table_cells(rows_by_policy(rows)))), "utf-8")
