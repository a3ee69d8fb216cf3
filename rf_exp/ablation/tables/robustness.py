"""What policies lose where scenes vary: what conf/experiment/robustness.yaml compares."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, newest
from rf_exp.ablation.statistics import paired
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.cells import Difference, Score, Text
from rf_exp.ablation.tables.counting import rates
from rf_exp.ablation.tables.published import paper
from rf_exp.ablation.tables.selection import BASELINE_ARCH, BASELINE_CONSTRAINTS, tasks_of
from rf_exp.ablation.tables.table import Column, Line, Table, title_of, with_violations
from rf_exp.types import UNVARIED

ALL = "full"  # the variation of all factors together, which comes last
Policy = tuple[
    str, str, str, int, bool, str
]  # task, recipe, learned on, demonstrations, shielded, architecture


def robustness(results: Results, suite: Suite) -> Table:
    """Success by the variation of scenes, for policies that acted in such scenes or have learned from them.

    Each is paired with the same policies in the same scenes without variation. Policies of others count too.
    """
    groups: dict[Policy, list[EvaluationRow]] = {}
    for row in results.evaluation:
        if row.constraints == BASELINE_CONSTRAINTS:
            how = row.recipe, row.learned_on, row.demos, row.shield, row.arch
            groups.setdefault((row.task, *how), []).append(row)
    varied = {policy: rows for policy, rows in groups.items() if any(map(varies, rows))}
    kept = [row for rows in varied.values() for row in rows]
    order = tasks_of([*paper().levels, *suite], kept)
    lines = []
    for policy in sorted(varied, key=lambda each: (order.index(each[0]), *_sorted(each))):
        lines += _of_policy(policy, varied[policy], suite)
    weaker = replace(results, evaluation=tuple(row for row in results.evaluation if varies(row)))
    return Table(
        "robustness",
        "Robustness",
        "Strict success where scenes vary by one factor, and by all of them (full); conf/variation says by "
        "which and how far. Difference: to the same policies in the same scenes without variation, with "
        "Newcombe's interval for pairs and McNemar's exact p. Score: how far a rollout came, the "
        f"largest part of the strict conditions that held at once; 1 is success. {notes.ROLLOUT_VIOLATIONS}",
        "Task",
        (
            Column("recipe", "Recipe", Text),
            Column("learned_on", "Learned on", Text),
            Column("demos", "Demos", Text),
            Column("scenes", "Scenes", Text),
            *with_violations("strict", "Strict success"),
            Column("difference", "Difference", Difference),
            Column("score", "Score", Score),
        ),
        tuple(lines),
        (*notes.left_out(weaker), *notes.mixed_versions(lines)) if lines else (),
    )


def varies(row: EvaluationRow) -> bool:
    """Whether anything varied, the scenes or what was learned from."""
    return {row.variation, row.learned_on} != {UNVARIED}


def in_order(variations: Iterable[str]) -> list[str]:
    """Scenes without variation first, those of all factors last."""
    return sorted(set(variations), key=lambda name: (name != UNVARIED, name == ALL, name))


def difference(rows: Sequence[EvaluationRow], without: Sequence[EvaluationRow]) -> Difference:
    """How far rows are above those without variation, over the scenes that both have; missing without one."""
    before = {(row.version, row.train_seed, row.scene_seed): row.success for row in without}
    keys = [(row.version, row.train_seed, row.scene_seed) for row in rows]
    pairs = [(row.success, before[key]) for row, key in zip(rows, keys, strict=True) if key in before]
    if not pairs:
        return Difference()
    found = paired(pairs)
    some = f"{len(pairs)} of {len(rows)} scenes were tried without variation too"
    note = some if len(pairs) < len(rows) else ""
    gap = found.estimate
    return Difference(gap.value, gap.n, gap.interval, note, rows[0].version, p=found.p)


def score(rows: Sequence[EvaluationRow]) -> Score:
    """The mean of the scores that are known."""
    known = [row.score for row in rows if row.score is not None]
    lost = len(rows) - len(known)
    note = f"ended before they were judged, and without a score: {lost}" if lost else ""
    if not known:
        return Score(note=note)
    return Score(fmean(known), len(known), note=note, version=rows[0].version)


def _sorted(policy: Policy) -> tuple[object, ...]:
    _, recipe, learned_on, demos, shield, arch = policy
    return _recipe(recipe, learned_on), arch, learned_on != UNVARIED, learned_on, demos, shield


def _recipe(recipe: str, learned_on: str) -> str:
    """Its name without the variation."""
    return recipe.replace(f"+{learned_on}", "", 1)


def _of_policy(policy: Policy, rows: Sequence[EvaluationRow], suite: Suite) -> list[Line]:
    """A line for each variation of the scenes in which a policy acted."""
    task, recipe, learned_on, demos, shield, arch = policy
    by_variation: dict[str, list[EvaluationRow]] = {}
    for row in newest(rows)[0]:
        by_variation.setdefault(row.variation, []).append(row)
    acting = ([arch] if arch != BASELINE_ARCH else []) + ["shielded"] * shield
    told = Text(", ".join([_recipe(recipe, learned_on), *acting])), Text(learned_on), Text(str(demos))
    lines = []
    for variation in in_order(by_variation):
        some = by_variation[variation]
        first = variation == UNVARIED
        gap = Difference(instead="-") if first else difference(some, by_variation.get(UNVARIED, []))
        key = "-".join([task, recipe, str(demos), *acting, variation])
        cells = (*told, Text(variation), *rates(some, None), gap, score(some))
        lines.append(Line(key, title_of(task, suite), cells))
    return lines
