"""Rows in, cells out: every attempt counts, failed ones too, of the newest version of the criteria."""

from collections.abc import Iterable, Sequence
from statistics import fmean

from rf_exp.ablation.rows import EvaluationRow, GenerationRow, newest
from rf_exp.ablation.statistics import mean, wilson
from rf_exp.ablation.tables.cells import Length, Rate, Violations

NO_SUCCESS = "no success"


def rate(rows: Iterable[GenerationRow | EvaluationRow], figure: float | None) -> Rate:
    """The rate of strict success over every attempt, also without a violation, with Wilson's intervals."""
    kept, note = newest(rows)
    if not kept:
        return Rate(paper=figure)
    estimate = wilson(sum(row.success for row in kept), len(kept))
    seeds = {row.train_seed for row in kept if isinstance(row, EvaluationRow)}
    pooled = f"{len(seeds)} training seeds together" if len(seeds) > 1 else ""
    return Rate(
        value=estimate.value,
        n=len(kept),
        interval=estimate.interval,
        paper=figure,
        note="; ".join(filter(None, [note, pooled])),
        success_paper=sum(row.success_paper for row in kept) / len(kept),
        version=kept[0].version,
        clean=wilson(sum(row.success and not row.violations for row in kept), len(kept)),
    )


def length(rows: Iterable[GenerationRow], figure: float | None) -> Length:
    """Mean control steps of the successful episodes, with Student's t interval."""
    kept, note = newest(rows)
    if not kept:
        return Length(paper=figure)
    version, steps = kept[0].version, [float(row.steps) for row in kept if row.success]
    if not steps:
        none = "; ".join(filter(None, [f"no success in {len(kept)} attempts", note]))
        return Length(instead=NO_SUCCESS, paper=figure, note=none, version=version)
    estimate = mean(steps)
    interval = estimate.interval if len(steps) > 1 else None
    return Length(estimate.value, len(steps), interval, note, version, paper=figure)


def violations(rows: Iterable[GenerationRow | EvaluationRow], of: str = "violations") -> Violations:
    """The share of attempts with at least one violation, with Wilson's interval, and the mean number.

    `of` names another field that is counted alike.
    """
    kept, note = newest(rows)
    if not kept:
        return Violations()
    counts = [getattr(row, of) for row in kept]
    found = wilson(sum(count > 0 for count in counts), len(kept))
    return Violations(
        found.value, found.n, found.interval, note, kept[0].version, mean_violations=fmean(counts)
    )


def rates(rows: Sequence[GenerationRow | EvaluationRow], figure: float | None) -> tuple[Rate, Violations]:
    """The rate of success, and the violations of the same attempts."""
    return rate(rows, figure), violations(rows)


def lengths(rows: Sequence[GenerationRow], figure: float | None) -> tuple[Length, Violations]:
    """The length of the successful episodes, and the violations on the way to them."""
    ours = length(rows, figure)
    if ours.instead:
        return ours, Violations(instead=ours.instead, version=ours.version)
    return ours, violations([row for row in newest(rows)[0] if row.success])


def average(cells: Sequence[Rate | Violations], figure: float | None) -> Rate | Violations:
    """The mean of the figures of a level; missing until every task of it was measured."""
    values = [cell.value for cell in cells if cell.value is not None]
    note = f"{len(values)} of {len(cells)} tasks measured" if values else ""
    missing = len(values) < len(cells)
    value, n, note = (None, 0, note) if missing else (fmean(values), sum(cell.n for cell in cells), "")
    means = [cell.mean_violations for cell in cells if isinstance(cell, Violations)]
    if not means:
        return Rate(value, n, note=note, paper=figure)
    known = [each for each in means if each is not None]
    return Violations(value, n, note=note, mean_violations=None if missing or not known else fmean(known))
