"""Writes docs/policies.md from the rows in results/evaluate: python docs/policies.py"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import fmean

from omegaconf import OmegaConf

from rf_exp.ablation import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    EvaluationRow,
    configured,
    core_minutes,
    load,
    markdown_rows,
    newest,
    paper,
    title_of,
    wilson,
)
from rf_exp.artifacts import rendered
from rf_exp.types import FOREIGN

ROOT = Path(__file__).parents[1]
HEADING = (
    *("task", "arms", "architecture", "recipe", "demos", "strict", "95 % interval", "scenes"),
    *("paper's criterion", "the paper", "rollouts with a violation", "core-minutes", "queries"),
)
RUNG = (
    *("recipe", "what is otherwise", "strict", "95 % interval", "each training seed", "scenes"),
    *("rollouts with a violation", "core-minutes"),
)
MOST = 3  # kinds of failures that are told of a policy
LADDER = ROOT / "conf" / "experiment" / "ladder.yaml"

WORDS = Path(__file__).with_suffix(".jinja")


def cells(rows: Iterable[EvaluationRow]) -> Iterator[tuple[EvaluationRow, list[EvaluationRow]]]:
    """The rows of each policy, in the order of the paper's tasks, with one of them."""
    found: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row in rows:
        if row.constraints == BASELINE_CONSTRAINTS and row.arch != FOREIGN.name:
            key = (row.task, row.recipe, row.arch != BASELINE_ARCH, row.arch, row.demos, row.shield)
            found.setdefault(key, []).append(row)
    order = [*paper().levels, *sorted({row.task for row in rows} - {*paper().levels})]
    for _, group in sorted(found.items(), key=lambda item: (order.index(str(item[0][0])), *item[0][1:])):
        kept, _ = newest(group)
        yield kept[0], list(kept)


def of_paper(row: EvaluationRow) -> float | None:
    """The paper's figure for the same task, architecture and number of demonstrations; an oracle has none."""
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
    known = configured().get(row.task)
    figure, cost = of_paper(row), core_minutes(group)
    return (
        title_of(row.task, configured()),
        str(known.agents if known else paper().levels[row.task]),
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
def rungs() -> list[str]:
    """The recipes of the ladder, `fast` first."""
    return str(OmegaConf.load(LADDER).hydra.sweeper.params.policy).replace(",", " ").split()


def step(recipe: str) -> str:
    """What the first line of a recipe says it does otherwise than `fast`, which says nothing so."""
    comment = (ROOT / "conf" / "policy" / f"{recipe}.yaml").read_text("utf-8").splitlines()[1:3]
    told = " ".join(line.removeprefix("# ") for line in comment if line.startswith("#"))
    return "" if recipe == rungs()[0] else re.split(r"\.(?: [A-Z]|$)", told.partition("): ")[2])[0]


def ladder(rows: Iterable[EvaluationRow]) -> list[tuple[str, str]]:
    """What each step of the recipe gives: of each task a line a rung, all training seeds together."""
    alone, node = rungs()[1:], OmegaConf.load(LADDER)
    found: dict[tuple[str, str], list[EvaluationRow]] = {}
    for row in rows:
        plain = row.arch == BASELINE_ARCH and row.constraints == BASELINE_CONSTRAINTS and not row.shield
        if plain and row.demos == node.demos and row.recipe in rungs():
            found.setdefault((row.task, row.recipe), []).append(row)
    parts = []
    for task in paper().levels:
        if not any((task, recipe) in found for recipe in alone):
            continue
        lines = [
            rung(recipe, list(newest(found[task, recipe])[0]))
            for recipe in rungs()
            if (task, recipe) in found
        ]
        parts.append((title_of(task, configured()), table(RUNG, lines)))
    return parts


def rung(recipe: str, group: list[EvaluationRow]) -> tuple[str, ...]:
    """The line of a rung."""
    seeds = sorted({row.train_seed for row in group})
    each = [fmean(row.success for row in group if row.train_seed == seed) for seed in seeds]
    return (
        recipe,
        step(recipe),
        *strict(group),
        ", ".join(f"{100 * share:.0f}" for share in each),
        str(len(group)),
        percent(fmean(row.violations > 0 for row in group)),
        f"{core_minutes(group):.1f}",
    )


def failures(row: EvaluationRow, group: list[EvaluationRow]) -> str:
    """What failed most often, in one line."""
    kinds = Counter(r.account.kind for r in group if not r.success)
    common = kinds.most_common(MOST)
    told = "; ".join(f"{kind} ({count})" for kind, count in common)
    more = sum(kinds.values()) - sum(count for _, count in common)
    name = f"{title_of(row.task, configured())}, {row.arch}, {row.recipe}, {row.demos}"
    return f"- **{name}{', shielded' * row.shield}**: {told}{f'; others ({more})' if more else ''}."


def of_table(row: EvaluationRow) -> bool:
    """Whether it is by our recipe, with as many demonstrations as the paper's table of architectures."""
    return row.recipe == "fast" and row.demos == paper().demos[-1] and not row.shield


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(markdown_rows(heading, rows))


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def architectures(found: Mapping[tuple[str, str], list[EvaluationRow]]) -> str:
    """The paper's second table: strict, its figure behind; a dash where nothing was measured."""
    known = paper().architectures
    asked = {task for each in known.values() for task in each}
    asked |= {task for task, arch in found if arch in known and arch != BASELINE_ARCH}
    tasks = [task for task in paper().levels if task in asked]
    rows = []
    for arch, figures in known.items():
        cells = [arch]
        for task in tasks:
            group, theirs = found.get((task, arch)), figures.get(task)
            ours = f"**{percent(fmean(r.success for r in group))}**" if group else "-"
            cells.append(ours if theirs is None else f"{ours} ({percent(theirs)})")
        rows.append(cells)
    return table(("architecture", *(title_of(task, configured()) for task in tasks)), rows)


def document() -> str:
    """The page: its words from the template, its figures from the rows."""
    rows = load(ROOT).evaluation
    groups = list(cells(row for row in rows if row.recipe not in rungs()[1:]))
    ours = {(row.task, row.demos) for row, _ in groups if row.arch == BASELINE_ARCH and row.recipe == "fast"}
    missing = [
        f"{title_of(task, configured())} ({', '.join(map(str, counts))})"
        for task in paper().levels
        if (counts := [demos for demos in paper().demos if (task, demos) not in ours])
    ]
    of_all = {(row.task, row.arch): group for row, group in groups if of_table(row)}
    failed = [failures(row, group) for row, group in groups if not all(r.success for r in group)]
    return rendered(
        WORDS,
        success=table(HEADING, (line(row, group) for row, group in groups)),
        missing="; ".join(missing),
        baseline=BASELINE_ARCH,
        most=paper().demos[-1],
        architectures=architectures(of_all),
        ladder=ladder(rows),
        ladder_demos=OmegaConf.load(LADDER).demos,
        failed="\n".join(failed),
        commits=", ".join(sorted({row.commit for row in rows})),
    )


if __name__ == "__main__":
    Path(__file__).with_suffix(".md").write_text(document(), "utf-8")
