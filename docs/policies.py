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
from origins import ORIGIN, learned_with, origins

from rf_exp.ablation import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    EvaluationRow,
    both_ways,
    configured,
    core_minutes,
    difference,
    is_baseline,
    load,
    newest,
    paper,
    title_of,
    trial,
    unvaried,
    wilson,
)
from rf_exp.artifacts import rendered
from rf_exp.tasks import CONFIGURED, read_task
from rf_exp.texts.markdown import table
from rf_exp.types import FOREIGN

ROOT = Path(__file__).parents[1]
HEADING = (
    *("task", "architecture", "recipe", "demos", "strict", "95 % interval", "scenes", "paper's criterion"),
    *("the paper", "rollouts with a violation", "core-minutes", "queries"),
)
SHIELD = (
    *("task", "demos", "scenes", "strict, without", "with"),
    *("violations, without", "with", "contacts, without", "with", "scenes in which it intervened"),
)
ABLATED = (
    *("recipe", "what is otherwise", "strict", "points above `fast`", "each training seed", "scenes"),
    *("rollouts with a violation", "core-minutes"),
)
MOST = 3  # kinds of failures that are told of a policy
START = "paper_short"  # where the ablation begins
ABLATION = ROOT / "conf" / "experiment" / "policy_ablation.yaml"

HERE = Path(__file__).parent
FIGURE = HERE / "images" / "policies.svg"

PEERS = [  # what others report: the first RERUN of them in a public rerun
    *("lift_barrier", "camera_alignment", "long_pipeline_delivery", "take_photo", "pass_shoe", "place_food"),
    *("two_robots_stack_cube", "three_robots_stack_cube"),
]
RERUN = 6
CHALLENGE = {  # the best that a public rerun has of 20 scenes, per cent by the release's criterion
    "place_cube_in_cup": 25,
    "strike_cube_hard": 95,
    "three_robots_place_shoes": 15,
    "four_robots_stack_cube": 20,
}
Cells = Mapping[tuple[str, str, int], list[EvaluationRow]]  # task, architecture, demonstrations


def cells(rows: Iterable[EvaluationRow]) -> Iterator[tuple[EvaluationRow, list[EvaluationRow]]]:
    """The rows of each policy, in the order of the paper's tasks, with one of them."""
    found: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row in rows:
        if row.constraints == BASELINE_CONSTRAINTS and row.arch != FOREIGN.name:
            key = (row.task, row.recipe, row.arch != BASELINE_ARCH, row.arch, row.demos, row.shield)
            found.setdefault(key, []).append(row)
    order = [*paper().levels, *sorted({str(task) for task, *_ in found} - {*paper().levels})]
    for _, group in sorted(found.items(), key=lambda item: (order.index(str(item[0][0])), *item[0][1:])):
        kept, _ = newest(group)
        yield kept[0], list(kept)


def of_fast(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> Cells:
    """Those that stand in the paper's tables: of our recipe, without the shield."""
    return {
        (row.task, row.arch, row.demos): group
        for row, group in groups
        if row.recipe == "fast" and not row.shield
    }


def of_paper(row: EvaluationRow) -> float | None:
    """The paper's figure for the same task, architecture and demonstrations; none with privileged state."""
    if row.observation == "state":
        return None
    if row.arch == BASELINE_ARCH:
        return paper().baseline.get(row.task, {}).get(row.demos)
    return paper().architectures.get(row.arch, {}).get(row.task) if row.demos == paper().demos[-1] else None


def strict(group: Sequence[EvaluationRow]) -> tuple[str, str]:
    """The share of the scenes that succeeded, and its 95 % interval."""
    rate = wilson(sum(row.success for row in group), len(group))
    return f"**{percent(rate.value)}**", f"{100 * rate.low:.0f} to {100 * rate.high:.0f}"


def line(row: EvaluationRow, group: list[EvaluationRow]) -> tuple[str, ...]:
    figure, cost = of_paper(row), core_minutes(group)
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
def choices() -> Mapping[str, str]:
    """The recipes of the ablation of policies with how each is chosen, `fast` first."""
    swept = str(OmegaConf.load(ABLATION).hydra.sweeper.params.policy).replace(",", " ").split()
    return {choice.rpartition("/")[2]: choice for choice in swept}


@cache
def ablated() -> list[str]:
    """Their names, as rows have them."""
    return [*choices()]


def step(recipe: str) -> str:
    """What the first line of a recipe says it does otherwise than `fast`, which says nothing so."""
    comment = (
        (ROOT / "conf" / "policy" / f"{choices().get(recipe, recipe)}.yaml")
        .read_text("utf-8")
        .splitlines()[1:3]
    )
    told = " ".join(line.removeprefix("# ") for line in comment if line.startswith("#"))
    told = told.removeprefix("Ablation: ")
    return "" if recipe == ablated()[0] else re.split(r"\.(?: [A-Z]|$)", told)[0]


def ablation(rows: Iterable[EvaluationRow], demos: int) -> list[tuple[str, str]]:
    """What each step of the recipe gives: of each task a line a recipe, all training seeds together."""
    listed = [START, *ablated()]
    found: dict[tuple[str, str], list[EvaluationRow]] = {}
    for row in rows:
        if is_baseline(row) and not row.shield and row.demos == demos and row.recipe in listed:
            found.setdefault((row.task, row.recipe), []).append(row)
    parts = []
    for task in paper().levels:
        if not any((task, recipe) in found for recipe in ablated()[1:]):
            continue
        groups = {r: list(newest(found[task, r])[0]) for r in listed if (task, r) in found}
        lines = [of_recipe(recipe, group, groups.get(ablated()[0], [])) for recipe, group in groups.items()]
        parts.append((title_of(task, configured()), table(ABLATED, lines)))
    return parts


def of_recipe(recipe: str, group: list[EvaluationRow], first: list[EvaluationRow]) -> tuple[str, ...]:
    """The line of a recipe, beside the first one's rollouts of the same training seeds."""
    seeds = sorted({row.train_seed for row in group})
    each = [fmean(row.success for row in group if row.train_seed == seed) for seed in seeds]
    same = [row for row in first if row.train_seed in seeds]
    rate, interval = strict(group)
    return (
        recipe,
        step(recipe),
        f"{rate} ({interval})",
        "" if not same or group == first else above(group, same),
        ", ".join(f"{100 * share:.0f}" for share in each),
        str(len(group)),
        percent(fmean(row.violations > 0 for row in group)),
        f"{core_minutes(group):.1f}",
    )


def above(group: Sequence[EvaluationRow], other: Sequence[EvaluationRow]) -> str:
    """By how many points of strict success a group is above another, with the 95 % interval."""
    rates = (wilson(sum(row.success for row in each), len(each)) for each in (group, other))
    gap = difference(*rates)
    points, low, high = (f"{round(100 * each):+d}" for each in (gap.value, gap.low, gap.high))
    return f"{points} ({low} to {high})"


def failures(row: EvaluationRow, group: list[EvaluationRow]) -> str:
    """What failed most often, in one line."""
    kinds = Counter(r.account.kind for r in group if not r.success)
    common = kinds.most_common(MOST)
    told = "; ".join(f"{kind} ({count})" for kind, count in common)
    more = sum(kinds.values()) - sum(count for _, count in common)
    name = f"{title_of(row.task, configured())}, {row.arch}, {row.recipe}, {row.demos}"
    return f"- **{name}{', shielded' * row.shield}**: {told}{f'; others ({more})' if more else ''}."


def percent(share: float) -> str:
    """In whole per cent, but for what would be none or all by rounding alone."""
    whole = round(100 * share)
    return f"{100 * share:.1f} %" if whole in (0, 100) and whole != 100 * share else f"{whole} %"


def baseline(found: Cells) -> str:
    """The paper's first table, and the mean over its tasks."""
    lines, columns = [], paper().demos
    for task, agents in paper().levels.items():
        figures = paper().baseline[task]
        rates = [beside(found.get((task, BASELINE_ARCH, demos)), figures[demos]) for demos in columns]
        lines.append([title_of(task, configured()), str(agents), *rates])
    means = ["mean", ""]
    for demos in columns:
        groups = [found.get((task, BASELINE_ARCH, demos)) for task in paper().levels]
        theirs = percent(fmean(paper().baseline[task][demos] for task in paper().levels))
        whole = all(groups) and percent(fmean(rate(group) for group in groups if group))
        means.append(f"**{whole}** ({theirs})" if whole else f"- ({theirs})")
    return table(("task", "arms", *(f"{demos} demonstrations" for demos in columns)), [*lines, means])


def panels(found: Cells) -> list[Panel]:
    """The paper's first table as its figure has it."""
    parts = []
    for task in paper().levels:
        groups = {n: found.get((task, BASELINE_ARCH, n), []) for n in paper().demos}
        ours = {n: wilson(sum(r.success for r in group), len(group)) for n, group in groups.items() if group}
        parts.append((title_of(task, configured()), ours, paper().baseline[task]))
    return parts


def architectures(found: Cells) -> str:
    """The paper's second table."""
    known, demos = paper().architectures, paper().demos[-1]
    asked = {task for each in known.values() for task in each}
    asked |= {task for task, arch, n in found if arch in known and arch != BASELINE_ARCH and n == demos}
    tasks = [task for task in paper().levels if task in asked]
    rows = [
        [arch, *(beside(found.get((task, arch, demos)), figures.get(task)) for task in tasks)]
        for arch, figures in known.items()
    ]
    return table(("architecture", *(title_of(task, configured()) for task in tasks)), rows)


def shielded(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> str:
    """The same policies in the same scenes without the shield and with it."""
    found: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row, group in groups:
        found.setdefault((row.task, row.arch, row.recipe, row.demos), []).extend(group)
    lines = []
    for rows in found.values():
        both, task, demos = both_ways(rows), title_of(rows[0].task, configured()), str(rows[0].demos)
        if not all(both):
            continue
        rates = (" (".join(strict(group)) + ")" for group in both)
        steps = [str(sum(row.violations for row in group)) for group in both]
        steps += [str(sum(row.contacts for row in group)) for group in both]
        kept = percent(fmean(row.interventions > 0 for row in both[1]))
        lines.append((task, demos, str(len(both[1])), *rates, *steps, kept))
    return table(SHIELD, lines)


def privileged(groups: Iterable[tuple[EvaluationRow, list[EvaluationRow]]]) -> str:
    """Policies that are told the true poses of all things, beside those of the same recipe that see."""
    found: dict[tuple[str, int], dict[str, list[EvaluationRow]]] = {}
    for row, group in groups:
        if is_baseline(row) and not row.shield and row.recipe in ("fast", "state"):
            found.setdefault((row.task, row.demos), {})[row.recipe] = group
    lines = [
        (
            title_of(task, configured()),
            str(demos),
            *(" (".join(strict(of[k])) + ")" for k in ("state", "fast")),
        )
        for (task, demos), of in found.items()
        if len(of) == 2
    ]
    return table(("task", "demos", "true poses", "pictures"), lines)


@cache
def step_limit(task: str) -> int:
    """Control steps after which a scene of a task ends."""
    return read_task(CONFIGURED / f"{task}.yaml").step_limit


def limits(rows: Sequence[EvaluationRow]) -> dict[str, int]:
    """The successes of our policies, and how many of them came later than the limit of their task is now."""
    won = [row for row in rows if row.success and row.arch != FOREIGN.name]
    return {"succeeded": len(won), "later": sum(row.steps > step_limit(row.task) for row in won)}


def hours(found: Cells) -> tuple[str, str]:
    """Of the first table, by one training seed: what learning and the scenes took, in hours of one core."""
    groups = [
        found.get((task, BASELINE_ARCH, demos), []) for task, demos in product(paper().levels, paper().demos)
    ]
    learning = sum(core_minutes(group) for group in groups) / 60
    scenes = (
        sum(row.wall_s / len({each.train_seed for each in group}) for group in groups for row in group) / 3600
    )
    return f"{learning:.1f}", f"{scenes:.1f}"


def compared(found: Cells) -> dict[str, list[str]]:
    """Lines of the table beside others: of PEERS in per cent, and the mean of those of the rerun."""
    most = paper().demos[-1]
    groups = [found[task, BASELINE_ARCH, most] for task in PEERS]
    rates = {
        "strict": [rate(group) for group in groups],
        "loose": [fmean(row.success_paper for row in group) for group in groups],
        "paper": [paper().baseline[task][most] for task in PEERS],
    }
    return {
        name: [*(f"{100 * each:.0f}" for each in line), f"{100 * fmean(line[:RERUN]):.1f}"]
        for name, line in rates.items()
    }


def challenge(found: Cells) -> dict[str, list[str]]:
    """Lines of the table of the challenge's four tasks; a dash where nothing was measured."""
    groups = [found.get((task, BASELINE_ARCH, paper().demos[-1]), []) for task in CHALLENGE]

    def line(told: Callable[[Sequence[EvaluationRow]], float]) -> list[str]:
        return [f"{told(group):.0f}" if group else "-" for group in groups]

    return {
        "strict": line(lambda group: 100 * rate(group)),
        "loose": line(lambda group: 100 * fmean(row.success_paper for row in group)),
        "learning": line(core_minutes),
    }


def gated(tables: Cells) -> str:
    """The tasks whose policies in the paper's tables, of most demonstrations, have a goal gate."""
    of_most = {
        task: group
        for (task, arch, demos), group in tables.items()
        if (arch, demos) == (BASELINE_ARCH, paper().demos[-1])
    }
    with_it = (task for task, group in of_most.items() if learned_with(group[0], "policy.goal_gate"))
    return ", ".join(title_of(task, configured()) for task in with_it)


def rate(group: Sequence[EvaluationRow]) -> float:
    return fmean(row.success for row in group)


def beside(group: Sequence[EvaluationRow] | None, figure: float | None) -> str:
    """A strict rate, and the paper's in brackets; a dash where nothing was measured."""
    ours = f"**{percent(rate(group))}**" if group else "-"
    return ours if figure is None else f"{ours} ({percent(figure)})"


def documents(rows: Sequence[EvaluationRow]) -> dict[Path, str]:
    """The pages: their words from templates, their figures from the rows."""
    groups = list(cells(row for row in rows if row.recipe not in ablated()[1:]))
    of_tables = of_fast(groups)
    failed = [failures(row, group) for row, group in groups if not all(r.success for r in group)]
    results = rendered(
        HERE / "policies.jinja",
        baseline=baseline(of_tables),
        architectures=architectures(of_tables),
        hours=hours(of_tables),
        compared=compared(of_tables),
        challenge=challenge(of_tables),
        gated=gated(of_tables),
        shielded=shielded(groups),
        privileged=privileged(groups),
        limits=limits(rows),
        every=table(HEADING, (line(row, group) for row, group in groups)),
        origins=table(ORIGIN, origins(row for row, _ in groups)),
        most=paper().demos[-1],
        failed="\n".join(failed),
        commits=", ".join(sorted({row.commit for row in rows})),
    )
    swept, most = OmegaConf.load(ABLATION).demos, paper().demos[-1]
    tried = rendered(
        HERE / "recipe_ablation.jinja",
        ablation=ablation(rows, swept),
        heads=ablation(rows, most),
        ablation_demos=swept,
        most=most,
    )
    return {HERE / "policies.md": results, HERE / "recipe_ablation.md": tried}


def measured() -> Sequence[EvaluationRow]:
    """The published rows of the suite's tasks and robots in usual scenes."""
    rows, suite = unvaried(trial(load(ROOT))).evaluation, configured()
    return [row for row in rows if row.task in suite]


if __name__ == "__main__":
    rows = measured()
    for path, text in documents(rows).items():
        path.write_text(text, "utf-8")
    FIGURE.write_text(figure(panels(of_fast(cells(rows)))), "utf-8")
