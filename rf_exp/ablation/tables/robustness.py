"""The robustness table: success of policies in varied scenes (conf/experiment/robustness.yaml)."""

from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, grouped, newest
from rf_exp.ablation.statistics import paired
from rf_exp.ablation.tables import notes
from rf_exp.ablation.tables.counting import BASELINE_ARCH, rates, tasks_of, varies, with_all_constraints
from rf_exp.ablation.tables.inputs import Suite, paper, title_of
from rf_exp.ablation.tables.table import (
    Column,
    Difference,
    Line,
    Score,
    Table,
    Text,
    text_columns,
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
    groups: dict[Policy, list[EvaluationRow]] = grouped(with_all_constraints(results.evaluation), policies)
    varied = {policy: rows for policy, rows in groups.items() if any(map(varies, rows))}
    order = tasks_of([*paper().levels, *suite], (row for rows in varied.values() for row in rows))

    def sort_key(policy: Policy) -> tuple[object, ...]:
        task, recipe, learned_on, demos, shield, arch = policy
        training_variation = learned_on != UNVARIED, learned_on
        return order.index(task), _recipe(recipe, learned_on), arch, *training_variation, demos, shield

    lines = [
        line for policy in sorted(varied, key=sort_key) for line in _lines(policy, varied[policy], suite)
    ]
    return Table(
        "robustness",
        "Robustness",
        "Strict success where scenes vary by one factor, and by all of them (full); conf/variation says by "
        "which and how far. Difference: to the same policies in the same scenes without variation, with "
        "Newcombe's interval for pairs and McNemar's exact p. Score: how far a rollout came, the "
        f"largest part of the strict conditions that held at once; 1 is success. {notes.ROLLOUT_VIOLATIONS}",
        "Task",
        (
            *text_columns(recipe="Recipe", learned_on="Learned on", demos="Demos", scenes="Scenes"),
            *with_violations("strict", "Strict success"),
            Column("difference", "Difference", Difference),
            Column("score", "Score", Score),
        ),
        tuple(lines),
        (*notes.left_out(filter(varies, results.evaluation)), *notes.mixed_versions(lines)) if lines else (),
    )


def sort_variations(variations: Iterable[str]) -> list[str]:
    """Sorted names of variations: none first, all factors last."""
    return sorted(set(variations), key=lambda name: (name != UNVARIED, name == ALL, name))


def _lines(policy: Policy, rows: Sequence[EvaluationRow], suite: Suite) -> Iterator[Line]:
    """A line for each variation of the scenes in which a policy acted."""
    task, recipe, learned_on, demos, shield, arch = policy
    by_variation = grouped(newest(rows)[0], lambda row: row.variation)
    qualifiers = ([arch] if arch != BASELINE_ARCH else []) + ["shielded"] * shield
    texts = Text(", ".join([_recipe(recipe, learned_on), *qualifiers])), Text(learned_on), Text(str(demos))
    for variation in sort_variations(by_variation):
        variation_rows = by_variation[variation]
        gap = Difference(placeholder="-")
        if variation != UNVARIED:
            gap = _difference(variation_rows, by_variation.get(UNVARIED, []))
        key = "-".join([task, recipe, str(demos), *qualifiers, variation])
        yield Line(
            key,
            title_of(task, suite),
            (*texts, Text(variation), *rates(variation_rows), gap, _score(variation_rows)),
        )


def _difference(rows: Sequence[EvaluationRow], nominal_rows: Sequence[EvaluationRow]) -> Difference:
    """Difference in success to rows without variation, over the scenes of both; missing if there are none."""
    nominal = {(row.version, row.train_seed, row.scene_seed): row.success for row in nominal_rows}
    keys = [(row.version, row.train_seed, row.scene_seed) for row in rows]
    pairs = [(row.success, nominal[key]) for row, key in zip(rows, keys, strict=True) if key in nominal]
    if not pairs:
        return Difference()
    result = paired(pairs)
    message = f"{len(pairs)} of {len(rows)} scenes were tried without variation too"
    note = message if len(pairs) < len(rows) else ""
    estimate = result.estimate
    return Difference(estimate.value, estimate.n, estimate.interval, note, rows[0].version, p=result.p)


def _score(rows: Sequence[EvaluationRow]) -> Score:
    """The mean of the scores that are known."""
    scores = [row.score for row in rows if row.score is not None]
    unjudged = len(rows) - len(scores)
    note = f"ended before they were judged, and without a score: {unjudged}" if unjudged else ""
    if not scores:
        return Score(note=note)
    return Score(fmean(scores), len(scores), note=note, version=rows[0].version)


def _recipe(recipe: str, learned_on: str) -> str:
    """The name of a recipe without the variation."""
    return recipe.replace(f"+{learned_on}", "", 1)
