"""The robustness table: success of policies in varied scenes (conf/experiment/robustness.yaml)."""

from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, grouped, newest
from rf_exp.ablation.statistics import paired
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.counting import BASELINE_ARCH, rates, tasks_of, under_all, varies
from rf_exp.ablation.tables.known import Suite, paper, title_of
from rf_exp.ablation.tables.table import (
    Column,
    Difference,
    Line,
    Score,
    Table,
    Text,
    of_texts,
    with_violations,
)
from rf_exp.types import UNVARIED

ALL = "full"  # the variation of all factors together, which comes last
# Task, recipe, variation of the demonstrations, their number, whether it is shielded, architecture.
Policy = tuple[str, str, str, int, bool, str]


def robustness(results: Results, suite: Suite) -> Table:
    """Success by the variation of scenes, for policies that acted in such scenes or have learned from them.

    Each is paired with the same policies in the same scenes without variation. Foreign policies count too.
    """
    policies = attrgetter("task", "recipe", "learned_on", "demos", "shield", "arch")
    groups: dict[Policy, list[EvaluationRow]] = grouped(under_all(results.evaluation), policies)
    varied = {policy: rows for policy, rows in groups.items() if any(map(varies, rows))}
    order = tasks_of([*paper().levels, *suite], (row for rows in varied.values() for row in rows))

    def place(policy: Policy) -> tuple[object, ...]:
        task, recipe, learned_on, demos, shield, arch = policy
        learned = learned_on != UNVARIED, learned_on
        return order.index(task), _recipe(recipe, learned_on), arch, *learned, demos, shield

    lines = [line for policy in sorted(varied, key=place) for line in _lines(policy, varied[policy], suite)]
    return Table(
        "robustness",
        "Robustness",
        "Strict success where scenes vary by one factor, and by all of them (full); conf/variation says by "
        "which and how far. Difference: to the same policies in the same scenes without variation, with "
        "Newcombe's interval for pairs and McNemar's exact p. Score: how far a rollout came, the "
        f"largest part of the strict conditions that held at once; 1 is success. {notes.ROLLOUT_VIOLATIONS}",
        "Task",
        (
            *of_texts(recipe="Recipe", learned_on="Learned on", demos="Demos", scenes="Scenes"),
            *with_violations("strict", "Strict success"),
            Column("difference", "Difference", Difference),
            Column("score", "Score", Score),
        ),
        tuple(lines),
        (*notes.left_out(filter(varies, results.evaluation)), *notes.mixed_versions(lines)) if lines else (),
    )


def in_order(variations: Iterable[str]) -> list[str]:
    """Sorted names of variations: none first, all factors last."""
    return sorted(set(variations), key=lambda name: (name != UNVARIED, name == ALL, name))


def _lines(policy: Policy, rows: Sequence[EvaluationRow], suite: Suite) -> Iterator[Line]:
    """A line for each variation of the scenes in which a policy acted."""
    task, recipe, learned_on, demos, shield, arch = policy
    by_variation = grouped(newest(rows)[0], lambda row: row.variation)
    acting = ([arch] if arch != BASELINE_ARCH else []) + ["shielded"] * shield
    told = Text(", ".join([_recipe(recipe, learned_on), *acting])), Text(learned_on), Text(str(demos))
    for variation in in_order(by_variation):
        some = by_variation[variation]
        gap = Difference(instead="-")
        if variation != UNVARIED:
            gap = _difference(some, by_variation.get(UNVARIED, []))
        key = "-".join([task, recipe, str(demos), *acting, variation])
        yield Line(key, title_of(task, suite), (*told, Text(variation), *rates(some), gap, _score(some)))


def _difference(rows: Sequence[EvaluationRow], without: Sequence[EvaluationRow]) -> Difference:
    """Difference in success to rows without variation, over the scenes of both; missing if there are none."""
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


def _score(rows: Sequence[EvaluationRow]) -> Score:
    """The mean of the scores that are known."""
    known = [row.score for row in rows if row.score is not None]
    lost = len(rows) - len(known)
    note = f"ended before they were judged, and without a score: {lost}" if lost else ""
    if not known:
        return Score(note=note)
    return Score(fmean(known), len(known), note=note, version=rows[0].version)


def _recipe(recipe: str, learned_on: str) -> str:
    """The name of a recipe without the variation."""
    return recipe.replace(f"+{learned_on}", "", 1)
