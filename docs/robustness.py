"""Writes the pages of robustness from conf/variation and the rows in results/: python docs/robustness.py"""

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from origins import ORIGIN_COLUMNS, origins

from rf_exp.ablation import (
    EvaluationRow,
    Results,
    configured,
    is_baseline,
    load,
    paired,
    robustness,
    title_of,
)
from rf_exp.artifacts import render_template
from rf_exp.command import CONF
from rf_exp.tasks import FACTORS, read_variation
from rf_exp.texts.markdown import table
from rf_exp.types import UNVARIED

ROOT = Path(__file__).parents[1]
HERE = Path(__file__).parent
VARIATIONS = CONF / "variation"
KEY_PATTERN = re.compile(r"^(\w+): [^#\n]+?(?: # (.+(?:\n# .+)*))?$", re.MULTILINE)
FACTOR_COLUMNS = "`variation=`", "what varies", "range", "stream"
Policy = tuple[str, str, int]  # task, recipe, demonstrations
Trial = tuple[str, int, int, int]  # version of the criteria, demonstrations, training seed, scene
MINUTES = "core-minutes"
DEMOS = 150
RECIPES = ("fast", "robust+full")  # of the first comparison: trained in nominal scenes, in varied ones
SUMMARY_VARIATIONS = ("none", "posture", "full")  # the columns of the first table


def variation_names() -> list[str]:
    """All choices of conf/variation: `none`, those of one factor, then those of several."""
    names = sorted(path.stem for path in VARIATIONS.glob("*.yaml"))
    return sorted(names, key=lambda name: (name != "none", random_stream(name) == "", name))


def random_stream(name: str) -> str:
    """The stream of random numbers of a choice with one factor; empty for several factors or none."""
    factors = read_variation(name).factors
    return f"{FACTORS.index(factors[0])}, `{factors[0]}`" if len(factors) == 1 else ""


def factor_line(name: str) -> tuple[str, str, str, str]:
    """The line of a choice: the first comment of its file, and the keys that differ from `none`."""
    comment = (VARIATIONS / f"{name}.yaml").read_text("utf-8").splitlines()[0]
    changed = read_variation(name).identity
    values = "; ".join(f"`{key}` {_range(value)}" for key, value in changed.items())
    streams = "" if name == "none" else random_stream(name) or "those of its factors"
    return f"`{name}`", _cell_text(comment.removeprefix("# ")), values or "nothing", streams


def keys() -> list[tuple[str, str]]:
    """Every key with its comment in none.yaml."""
    meanings = {
        key: meaning for key, meaning in KEY_PATTERN.findall((VARIATIONS / "none.yaml").read_text("utf-8"))
    }
    return [
        (f"`{key}`", _cell_text(meaning.replace("\n# ", " ")))
        for key, meaning in meanings.items()
        if key != "name"
    ]


def measured(results: Results) -> str:
    """The table of robustness; empty for no measurements."""
    robustness_table = robustness(results, configured())
    if not robustness_table.lines:
        return ""
    columns = [k for k, column in enumerate(robustness_table.columns) if column.key != "strict_violations"]
    heading = [
        robustness_table.heading.lower(),
        *(robustness_table.columns[k].title.lower() for k in columns),
    ]
    lines = []
    for line in robustness_table.lines:
        lines.append([line.title, *(line.cells[k].markdown() for k in columns)])
    return table(heading, lines)


def summary(results: Results) -> str:
    """Strict success, per cent: one line per policy of RECIPES; nominal scenes, other postures, all factors.

    Empty for no measurements in scenes that vary.
    """
    lines = [
        [title_of(task, configured()), f"`{recipe.partition('+')[0]}`", str(demos)]
        + [_percent(rates.get(name, ())) for name in SUMMARY_VARIATIONS]
        for (task, recipe, demos), rates in _rates(results).items()
    ]
    heading = ["task", "recipe", "demonstrations", *(f"`{name}`" for name in SUMMARY_VARIATIONS)]
    return table(heading, lines) if lines else ""


def single_factor_table(results: Results) -> str:
    """The same for scenes with one factor, one line per variation; empty for no measurements."""
    rates = _rates(results)
    policies = [policy for policy, by_variation in rates.items() if {*by_variation} - {*SUMMARY_VARIATIONS}]
    lines = [
        [f"`{name}`", *(_percent(rates[policy].get(name, ())) for policy in policies)]
        for name in variation_names()
        if name not in SUMMARY_VARIATIONS and any(name in rates[policy] for policy in policies)
    ]
    heading = [
        f"{title_of(task, configured())}, `{recipe.partition('+')[0]}`" for task, recipe, _ in policies
    ]
    return table(["scenes", *heading], lines) if lines else ""


def _suite(results: Results) -> list[EvaluationRow]:
    """The rows of the suite's tasks and of RECIPES with at least DEMOS demonstrations."""
    rows = (row for row in results.evaluation if row.task in configured() and row.recipe in RECIPES)
    return [row for row in rows if row.demos >= DEMOS and is_baseline(row) and not row.shield]


def _rates(results: Results) -> dict[Policy, dict[str, list[bool]]]:
    """Policy -> variation -> successes, for tasks that are measured in scenes that vary."""
    by_policy: dict[Policy, dict[str, list[bool]]] = {}
    for row in _suite(results):
        by_variation = by_policy.setdefault((row.task, row.recipe, row.demos), {})
        by_variation.setdefault(row.variation, []).append(row.success)
    varied = {task for (task, *_), by_variation in by_policy.items() if by_variation.keys() - {UNVARIED}}
    order = list(configured())
    policies = sorted(
        by_policy, key=lambda policy: (order.index(policy[0]), RECIPES.index(policy[1]), policy[2])
    )
    return {policy: by_policy[policy] for policy in policies if policy[0] in varied}


def _percent(successes: Sequence[bool]) -> str:
    return f"{100 * sum(successes) / len(successes):.0f}" if successes else ""


def compare_recipes(results: Results, first: str, second: str, minutes: bool) -> str:
    """Table of two recipes in the same scenes; empty if no scene was measured with both."""
    cells: dict[tuple[str, str, str], dict[Trial, EvaluationRow]] = {}
    for row in results.evaluation:
        if is_baseline(row) and not row.shield:
            trial = row.version, row.demos, row.train_seed, row.scene_seed
            cells.setdefault((row.task, row.variation, row.recipe), {})[trial] = row
    suite, lines = configured(), []
    for task, scenes in product(suite, ("none", "posture", "full")):
        first_rows, second_rows = (
            cells.get((task, scenes, f"{recipe}+full"), {}) for recipe in (first, second)
        )
        pairs = [
            (first_rows[trial], second_rows[trial])
            for trial in sorted(first_rows.keys() & second_rows.keys())
        ]
        if not pairs:
            continue
        success = [(a.success, b.success) for a, b in pairs]
        first_successes, second_successes = map(sum, zip(*success, strict=True))
        differ = [b for a, b in success if a != b]
        p, cost = paired(success).p, [f"{row.core_s / 60:.0f}" for row in pairs[0]]
        shares = [
            str(first_successes),
            f"**{second_successes}**",
            f"{sum(differ)}, {len(differ) - sum(differ)}",
        ]
        shares += ["<0.001" if p < 0.001 else f"{p:.2g}", *(cost if minutes else ())]
        lines.append([title_of(task, suite), f"`{scenes}`", *shares])
    names = f"`{first}`", f"`{second}`"
    costs = [f"{MINUTES}, {name}" for name in names] if minutes else []
    return table(["task", "scenes", *names, "won, lost", "p", *costs], lines) if lines else ""


def _cell_text(comment: str) -> str:
    """A comment as text of a table cell."""
    return comment.replace("|", "\\|")


def _range(value: object) -> str:
    return f"{value[0]} to {value[1]}" if isinstance(value, list | tuple) else str(value)


def documents(results: Results) -> dict[Path, str]:
    """Path -> text of the pages: measurements, and the development of `robust`."""
    varied = (row for row in results.evaluation if "+full" in row.recipe and is_baseline(row))
    policies = {(row.task, row.recipe, row.demos, row.train_seed): row for row in varied}
    main_page = render_template(
        HERE / "robustness.jinja",
        factors=table(FACTOR_COLUMNS, [factor_line(name) for name in variation_names()]),
        keys=table(("key", "meaning"), keys()),
        summary=summary(results),
        alone=single_factor_table(results),
        measured=measured(results),
        origins=table(ORIGIN_COLUMNS, origins(policies.values())),
        homing=compare_recipes(results, "without_homing", "robust", minutes=False),
        search=compare_recipes(results, "without_search", "robust", minutes=False),
    )
    crop_refinement = compare_recipes(results, "without_crop_refinement", "without_homing", minutes=True)
    trials_page = render_template(HERE / "robustness_trials.jinja", looks=crop_refinement)
    return {HERE / "robustness.md": main_page, HERE / "robustness_trials.md": trials_page}


if __name__ == "__main__":
    for path, text in documents(load(ROOT)).items():
        path.write_text(text, "utf-8")
